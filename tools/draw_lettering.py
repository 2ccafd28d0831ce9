"""Draws the letters of films' titles anew: python tools/draw_lettering.py, with Pillow and DejaVu.

Writes src/cadenza/performing/lettering.npz: `letters`, in the order of the columns of `atlas`
(height, width), whose values are from 0, nothing, to 15, ink; and `widths`, those of their columns.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

FONT = "/usr/share/fonts/truetype/dejavu/DejaVuSans.ttf"
FILE = Path(__file__).parents[1] / "src/cadenza/performing/lettering.npz"
SIZE, HEIGHT = 40, 52  # [px]
# Latin letters of Europe, and signs that titles have
LETTERS = "".join(map(chr, (*range(0x20, 0x7F), *range(0xA1, 0x180)))) + "–—‘’“”…№♭♮♯"


def main() -> None:
    """Writes the file."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    font = ImageFont.truetype(FONT, SIZE)
    letters = [letter for letter in LETTERS if letter != "\xad"]
    widths = [round(font.getlength(letter)) for letter in letters]
    atlas = Image.new("L", (sum(widths), HEIGHT))
    for letter, right, width in zip(letters, np.cumsum(widths), widths, strict=True):
        column = Image.new("L", (width, HEIGHT))
        ImageDraw.Draw(column).text((0, 2), letter, fill=255, font=font)
        atlas.paste(column, (int(right) - width, 0))
    np.savez_compressed(
        FILE,
        letters=np.array(letters),
        widths=np.array(widths, np.uint8),
        atlas=np.rint(np.asarray(atlas) / 17).astype(np.uint8),
    )


if __name__ == "__main__":
    main()
