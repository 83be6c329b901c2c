"""A tiny plan whose light field is a formula, put where a bake would be: episodes in a second instead of minutes."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from gelsim.data.lightfield import LightField, write_field
from gelsim.generate.plan import Catalogue, load_plan
from gelsim.optics import bake
from gelsim.scene.definition import Scene

TINY = str(Path(__file__).parent / "plan_tiny.toml")


def formula_field(scene: Scene) -> LightField:
    """Each lamp lights by the cosine with its direction from the gel's middle, in its own colour; no light from elsewhere but a veil."""
    size, lights = 9, scene.lights.lights
    n = np.linspace(-0.9, 0.9, size)
    ny, nx = np.meshgrid(n, n, indexing="ij")
    nz = np.sqrt(np.maximum(1 - nx**2 - ny**2, 0.05))
    slots = -(-len(lights) // 4) * 4
    table, colours, light_of = np.zeros((2, 5, 6, size, size, slots), np.float32), np.zeros((slots, 3), np.float32), np.full(slots, -1)
    for k, light in enumerate(lights):
        toward = np.array(light.position_mm) / np.linalg.norm(light.position_mm)
        # The normal points out of the gel, the lamps stand inside.
        table[..., k] = np.maximum(-(nx * toward[0] + ny * toward[1] + nz * toward[2]), 0.0)
        colours[k], light_of[k] = np.array(light.rgb) * light.power / 2e4, k
    veil = np.zeros((5, 6, 4), np.float32)
    veil[..., :3] = 3e-4
    field, paint = np.array([[-10, 10], [-8, 8]], np.float32), np.full((size, size), 0.1, np.float32)
    return LightField(
        table, np.array([-0.4, -2.0], np.float32), field, 0.9, colours, light_of.astype(np.int32), paint, np.full(3, 0.3, np.float32), veil
    )


def put_fields(plan: str, seed: int) -> None:
    """Writes the formula field of every sensor of a plan's pool into the cache ($GELSIM_CACHE)."""
    catalogue = Catalogue(load_plan(plan), seed)
    for number in range(catalogue.plan.sensors):
        scene = catalogue.sensor_scene(number)
        write_field(bake.field_path(scene), formula_field(scene))


def contents(folder: Path) -> dict[str, str]:
    """Digest of every file but the one that holds times."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "seconds.jsonl"
    }
