"""Shared fixtures: a made-up press and made-up pictures, for what reads and writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gelsim.errors import SolveStatus
from gelsim.geometry import split_faces
from gelsim.results import Deformation, Frame, SurfaceMotion


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--regenerate",
        action="store_true",
        help="write golden data (tests/golden/*.npz, [expect] of scenes/*.toml) anew, not compare",
    )


@pytest.fixture
def regenerate(request: pytest.FixtureRequest) -> bool:
    """Whether golden data are to be written."""
    return request.config.getoption("--regenerate")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20170529)


@pytest.fixture
def sheet_motion() -> SurfaceMotion:
    """A 10 x 6 mm surface of 4 x 3 x 2 six-node faces that moves by a quadratic field, in three states."""
    columns, rows = 9, 7  # corner and mid-side nodes in one grid
    x, y = np.meshgrid(np.linspace(-5e-3, 5e-3, columns), np.linspace(-3e-3, 3e-3, rows), indexing="ij")
    rest = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    node = np.arange(x.size).reshape(columns, rows)
    faces = []
    for i in range(0, columns - 1, 2):
        for j in range(0, rows - 1, 2):
            a, b, c, d = node[i, j], node[i + 2, j], node[i + 2, j + 2], node[i, j + 2]
            middle = node[i + 1, j + 1]
            faces.append([a, b, c, node[i + 1, j], node[i + 2, j + 1], middle])
            faces.append([a, c, d, middle, node[i + 1, j + 2], node[i, j + 1]])
    faces6 = np.array(faces, np.int32)
    load = np.array([0.0, 0.5, 1.0])[:, None]
    px, py = rest[:, 0] / 1e-3, rest[:, 1] / 1e-3
    field = np.stack([1e-5 * px * py, -2e-5 * px, -1e-4 * (1.0 - 0.01 * px**2 - 0.02 * py**2)], axis=1)
    return SurfaceMotion(rest, split_faces(faces6), load[:, :, None] * field, faces6)


@pytest.fixture
def deformation(sheet_motion: SurfaceMotion) -> Deformation:
    """A made-up press of three states on `sheet_motion`; the object is the same surface a little higher."""
    above = SurfaceMotion(sheet_motion.rest + [0, 0, 1e-3], sheet_motion.faces, sheet_motion.displacement, sheet_motion.faces6)
    count = len(sheet_motion.displacement)
    return Deformation(
        approach=np.linspace(0.0, 1e-3, count),
        time=np.linspace(0.0, 0.2, count),
        force=np.array([[0.0, 0.0, -0.5 * i] for i in range(count)]),
        contact_area=np.linspace(0.0, 2e-5, count),
        contact_pressure=np.linspace(0.0, 3e4, count)[:, None] * np.ones(len(sheet_motion.rest)),
        gel=sheet_motion,
        object=above,
        min_jacobian=np.ones(count),
        penetration=np.zeros(count),
        newton_iterations=np.zeros(count, np.int32),
        linear_iterations=np.zeros(count, np.int32),
        seconds=np.zeros(count),
        converged=np.ones(count, bool),
        status=SolveStatus.CONVERGED,
    )


@pytest.fixture
def frames(rng: np.random.Generator) -> list[Frame]:
    """Three made-up pictures of odd size with four markers, one of them outside."""
    pictures = []
    for index in range(3):
        radiance = rng.random((31, 41, 3)).astype(np.float32)
        markers = np.array([[3.25, 4.5], [10.0, 20.0 + index], [np.nan, np.nan], [39.0, 29.0]])
        height = np.full((31, 41), -1e-4 * index, np.float32)
        pictures.append(Frame(radiance, (255 * radiance).astype(np.uint8), height, markers))
    return pictures


@pytest.fixture
def repository() -> Path:
    return Path(__file__).parent.parent
