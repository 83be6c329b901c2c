"""How straight the membrane is along a rigid part's straight edges: photographs of such parts show no teeth.

    python docs/studies/straight_edges.py [--fidelity balanced] [--picture docs/images/straight_edges.jpg]

A box of 5 x 7 mm and a triangular prism, 0.4 mm deep. Along the middle half of each edge, 0.15 and 0.3 mm outside it, heights are read from
the membrane as it was solved; what is left of them without their parabola is told in micrometres RMS. --picture draws both parts.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import trimesh
from manifold3d import CrossSection
from numpy.typing import NDArray
from PIL import Image

import gelsim
from gelsim.pipeline import outputs, stages
from gelsim.results import Deformation
from gelsim.scene.definition import Scene
from gelsim.scene.layers import build_scene

Array = NDArray[np.float64]
BOX = np.array([[-2.5, -3.5], [2.5, -3.5], [2.5, 3.5], [-2.5, 3.5]])
TRIANGLE = np.array([[-4.0, -2.0], [4.5, -2.5], [-3.0, 3.0]])
OUTSIDE_MM = (0.15, 0.3)


def press(corners: Array, fidelity: str, **body: object) -> tuple[Scene, Deformation, Array]:
    """A prism's scene, its press, and the corners of its face where it lies on the gel [mm]."""
    if not body:
        solid = CrossSection([corners]).extrude(8).to_mesh()
        path = Path(tempfile.mkdtemp()) / "part.stl"
        trimesh.Trimesh(solid.vert_properties[:, :3], solid.tri_verts).export(path)
        body = {"shape": "mesh", "mesh": str(path)}
    scene = build_scene({"object": body | {"rigid": True}, "press": {"depth_mm": 0.4, "frames": 3}, "fidelity": fidelity})
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2  # a file's lowest points are centred
    return scene, stages.press(scene), corners - middle


def waver(solved: Deformation, start: Array, end: Array, outside_mm: float) -> float:
    """RMS [µm] of the heights along the middle half of an edge (its ends counter-clockwise), less their parabola."""
    along = (end - start) / np.linalg.norm(end - start)
    share = np.linspace(0.25, 0.75, 400)
    places = start + share[:, None] * (end - start) + outside_mm * np.array([along[1], -along[0]])
    surface = solved.gel
    nodes, weights = outputs.surface_shares(surface.rest, surface.faces6, places * 1e-3)
    height = (weights * surface.displacement[-1][nodes][..., 2]).sum(axis=1)
    return float(1e6 * np.std(height - np.polyval(np.polyfit(share, height, 2), share)))


def main(fidelity: str = "balanced", picture: Path | None = None) -> dict[str, list[float]]:
    """Wavering [µm] by part and edge, 0.15 and 0.3 mm outside."""
    found, seen = {}, []
    box = {"shape": "box", "width_mm": 5.0, "length_mm": 7.0, "height_mm": 5.0}
    for name, corners, body in (("box", BOX, box), ("prism", TRIANGLE, {})):
        scene, solved, placed = press(corners, fidelity, **body)
        if picture:
            seen.append(gelsim.render(scene, solved)[-1].image)
        for number in range(len(placed)):
            ends = placed[number], placed[(number + 1) % len(placed)]
            found[f"{name}, edge {number + 1}"] = [waver(solved, *ends, outside) for outside in OUTSIDE_MM]
    if picture:
        Image.fromarray(np.hstack(seen)).save(picture, quality=85)
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fidelity", default="balanced")
    parser.add_argument("--picture", type=Path)
    for edge, values in main(**vars(parser.parse_args())).items():
        print(f"{edge:16s}", *(f"{value:6.2f}" for value in values), "um RMS at", *OUTSIDE_MM, "mm")
