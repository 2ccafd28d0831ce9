"""What report pages hold."""

import base64
import json
import re
import zlib
from typing import Any


def recording_in(page: str) -> dict[str, Any]:
    """The recording of the one performance in a page."""
    (packed,) = re.findall(r'class="recording"[^>]*>([^<]*)<', page)
    recording: dict[str, Any] = json.loads(zlib.decompress(base64.b64decode(packed)))
    return recording
