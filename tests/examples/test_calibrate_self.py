"""A known sensor is found again from its own photographs, to accuracies that docs/calibrate.md speaks of."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

from gelsim.calibrate import run
from gelsim.scene.layers import build_scene


@pytest.mark.slow
def test_a_known_sensor_is_found(repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Few, small pictures of which every other pixel is fitted, and a gel that is given: for the sake of time.
    monkeypatch.setattr(run, "MOST_PIXELS", 3000)
    width, height, pixel_mm = 64, 48, 18 / 64
    study = runpy.run_path(str(repository / "docs" / "studies" / "calibrate_self.py"))
    sensor, presses = study["write_photos"](tmp_path / "photos", width, height, 6, spp=64, gel_known=True)
    report = study["calibrate"](tmp_path / "photos", tmp_path / "sensor.toml", sensor="self")
    rows = study["compare"](report, sensor, presses)

    def errors(ending: str, *, relative: bool = False) -> np.ndarray:
        return np.array([abs(got - wanted) / (abs(wanted) if relative else 1.0) for name, wanted, got, *_ in rows if name.endswith(ending)])

    # Three lights, none more, where they are: the start's stand on a grid of 15 degrees, and at distances 1.6 apart.
    assert len(report["fit"]["lights"]) == 4 and report["fit"]["lights"][-1] == "veil"
    assert errors("azimuth_deg").max() < 2
    assert errors("away_mm", relative=True).max() < 0.08 and errors(".z_mm", relative=True).max() < 0.08
    # Three of their standard deviations. A light whose shadow is not as soft as it is long is found 20 to 60 % too tall; the ring of
    # inter-reflection that is smoothed away made the coat 0.163.
    assert errors("specular").max() < 0.036 and errors("roughness").max() < 0.03
    assert errors("height_mm", relative=True).max() < 0.2
    # Presses to a tenth of a pixel, and to 3 % of the depth.
    assert max(errors("png.x_mm").max(), errors("png.y_mm").max()) < 0.1 * pixel_mm
    assert errors("depth_mm", relative=True).max() < 0.03
    # A picture not fitted to: noise 1.5² and rounding, twice 1/12, make 2.4; what the rest keeps of its noise 0.6;
    # the renderer's noise about 0.5; that leaves 1.5 for the fit. With one no-contact photograph as the rest it was 6.1.
    assert report["scores"]["test"]["whole"]["mse"] < 5
    assert report["scores"]["no_contact_as_test"]["whole"]["mse"] > 20
    # Standard deviations are what they say: the sensor's own parameters lie within two of them, and these are not too wide to say anything.
    own = np.array([(abs(got - wanted), sd) for name, wanted, got, sd, _ in rows if not name.startswith("press_")]).T
    assert (own[0] < 2 * own[1]).mean() >= 0.8
    assert np.median(own[1]) <= 2 * np.median(own[0])
    # The preset is a sensor.
    scene = build_scene({"sensor": {"preset": str(tmp_path / "sensor.toml")}})
    assert scene.camera.resolution == (width, height) and len(scene.lights.lights) == len(report["fit"]["lights"])
    assert {path.name for path in tmp_path.iterdir()} == {
        "photos",
        "sensor.toml",
        "sensor_rest.png",
        "report.json",
        "comparison.png",
        "residuals.png",
    }
