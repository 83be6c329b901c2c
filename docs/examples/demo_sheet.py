"""The README's first picture: the sheet that `make demo` made.

make demo && python docs/examples/demo_sheet.py       # out/demo/sheet.png, made smaller, to docs/images/sheet.png
"""

from __future__ import annotations

from pathlib import Path

from shore_series import write_small

ROOT = Path(__file__).parents[2]

if __name__ == "__main__":
    write_small(ROOT / "out" / "demo" / "sheet.png", ROOT / "docs" / "images" / "sheet.png")
