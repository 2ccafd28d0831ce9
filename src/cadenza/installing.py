"""The command that installs an extra of Cadenza, from where Cadenza was installed."""

import json
import shutil
import sys
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from shlex import quote
from urllib.parse import unquote, urlsplit

_NOT_BY_MAKE = ("gpu", "wandb")  # extras for which `make install` would be too large
_SOURCES = Path(__file__).parents[2]  # where this is a clone


def install_line(extra: str) -> str:
    """The command that installs an `extra` into the environment that runs.

    In the environment of a clone, that is `make install`; elsewhere pip or uv, whichever has
    installed Cadenza, installs from where that was installed from: a folder, a file such as a
    wheel, a repository or an index.
    """
    try:
        installed = distribution("cadenza")
    except PackageNotFoundError:  # run from its sources
        return f"{_pip()} --editable {quote(f'{_SOURCES}[{extra}]')}"
    origin = json.loads(installed.read_text("direct_url.json") or "{}")
    url, requirement = origin.get("url", ""), f"cadenza[{extra}]"
    if origin.get("dir_info", {}).get("editable"):
        folder = Path(unquote(urlsplit(url).path))
        if folder / ".venv" == Path(sys.prefix) and extra not in _NOT_BY_MAKE:
            there = "" if folder == Path.cwd() else f"-C {quote(str(folder))} "
            return f"make {there}install"
        return f"{_installer(installed)} --editable {quote(f'{folder}[{extra}]')}"
    if repository := origin.get("vcs_info"):
        url = f"{repository['vcs']}+{url}@{repository['commit_id']}"
    return f"{_installer(installed)} {quote(f'{requirement} @ {url}' if url else requirement)}"


def _installer(installed: Distribution) -> str:
    """The command of the installer of Cadenza that adds packages to this environment."""
    if (installed.read_text("INSTALLER") or "").strip() == "uv":  # which installs no pip
        return f"uv pip install --python {quote(sys.prefix)}"
    return _pip()


def _pip() -> str:
    """The command of pip for this environment, as a shell finds it."""
    pip = shutil.which("pip")
    here = pip and Path(pip).parent == Path(sys.executable).parent
    return "pip install" if here else f"{quote(sys.executable)} -m pip install"
