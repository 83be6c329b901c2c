"""A press as a page that works offline, and as surfaces for ParaView."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import meshio
import numpy as np
import pytest

from gelsim.cli import main as cli
from gelsim.pipeline import outputs
from gelsim.results import Deformation, Frame
from gelsim.scene.definition import Scene
from gelsim.views import press_page

CHROMIUM = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)


@pytest.fixture
def result(tmp_path: Path, deformation: Deformation, frames: list[Frame]) -> Path:
    """A result folder with a press and, for each of its states, a picture."""
    folder = tmp_path / "result"
    folder.mkdir()
    outputs.write_press(folder / "press.npz", Scene(), deformation)
    outputs.write_frames(folder / "frames", [frames[0]] * len(deformation.approach))
    return folder


def test_series_holds_the_surfaces(tmp_path: Path, deformation: Deformation) -> None:
    written = press_page.write_series(tmp_path / "vtu", deformation)
    states = len(deformation.approach)
    assert len(written) == 2 * states + 1
    last = meshio.read(tmp_path / "vtu" / f"gel_{states - 1:04d}.vtu")
    np.testing.assert_array_equal(last.points, deformation.gel.rest + deformation.gel.displacement[-1])
    np.testing.assert_array_equal(last.cells_dict["triangle6"], deformation.gel.faces6)
    np.testing.assert_array_equal(last.point_data["contact_pressure"], deformation.contact_pressure[-1])
    listed = re.findall(r'file="([^"]+)"', (tmp_path / "vtu" / "press.pvd").read_text())
    assert len(listed) == 2 * states and all((tmp_path / "vtu" / name).is_file() for name in listed)


def test_page_is_whole_and_asks_for_nothing(tmp_path: Path, result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page.html"
    assert cli.main(["inspect", str(result), "--html", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    # Nothing is loaded from elsewhere: no script, style or picture by address.
    assert not re.findall(r"<(?:script|link|img)[^>]+(?:src|href)=[\"']?https?:", text)
    states = len(outputs.read_press(result / "press.npz").approach)
    # plotly writes a slash so; the states' pictures, and the one that is shown at first.
    assert text.count("data:image\\u002fpng;base64") == states + 1
    assert cli.main(["inspect", str(result), "--html", str(page)]) == 2
    (tmp_path / "press.npz").write_bytes((result / "press.npz").read_bytes())
    page.unlink()
    assert cli.main(["inspect", str(tmp_path / "press.npz"), "--html"]) == 0 and page.is_file()
    assert cli.main(["inspect", "--sensor", "digit", "--html", str(tmp_path / "other.html")]) == 2
    assert cli.main(["inspect", str(tmp_path / "nothing"), "--vtu", str(tmp_path / "vtu")]) == 2
    assert not (tmp_path / "other.html").exists() and not (tmp_path / "vtu").exists()


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
def test_page_opens_in_a_browser(tmp_path: Path, result: Path) -> None:
    page = tmp_path / "page.html"
    assert cli.main(["inspect", str(result), "--html", str(page)]) == 0
    assert CHROMIUM is not None

    def shown(text: str, window: str = "1400,1000") -> str:
        page.write_text(text, encoding="utf-8")
        flags = [
            "--headless",
            "--no-sandbox",
            "--enable-unsafe-swiftshader",
            "--virtual-time-budget=10000",
            f"--window-size={window}",
            f"--user-data-dir={tmp_path}/profile",
        ]
        dom = subprocess.run([CHROMIUM, *flags, "--dump-dom", page.as_uri()], capture_output=True, text=True, timeout=120).stdout
        return re.sub(r"<script.*?</script>", "", dom, flags=re.DOTALL)

    whole = page.read_text(encoding="utf-8")
    drawn = shown(whole)
    # What the script makes when it has run: the slider, the curve, the 3D scene's canvas.
    made = ("slider-group", "scatterlayer", "<canvas")
    assert all(name in drawn for name in made)
    # It fills its window: as wide, and lower by as much as that is; what frames the window is the same for both.
    sizes = [re.search(r'class="main-svg"[^>]*? width="(\d+)" height="(\d+)"', text) for text in (drawn, shown(whole, "900,600"))]
    (wide, high), (narrow, low) = (map(int, size.groups()) for size in sizes if size)
    assert (wide, narrow, high - low) == (1400, 900, 400)
    # Planted: the figure's data cut short.
    broken = shown(whole.replace("Plotly.newPlot(", "Plotly.newPlot((", 1))
    assert "<body" in broken and not any(name in broken for name in made)
