"""The README's first picture: the sheet that `make demo` made.

make demo && python docs/examples/demo_sheet.py       # out/demo/sheet.png, made smaller, to docs/images/sheet.jpg
"""

from __future__ import annotations

from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[2]

if __name__ == "__main__":
    with Image.open(ROOT / "out" / "demo" / "sheet.png") as sheet:
        sheet.convert("RGB").save(ROOT / "docs" / "images" / "sheet.jpg", quality=93, subsampling=0, optimize=True)
