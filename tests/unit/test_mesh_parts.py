"""Mesh parts that a study draws: the same for a number, watertight, and scenes."""

from __future__ import annotations

from pathlib import Path

import pytest
import trimesh

from gelsim.bench import mesh_parts, random_scenes

SEED = 36


def test_parts_depend_on_their_number_alone() -> None:
    first = [mesh_parts.draw(index, SEED) for index in range(12)]
    assert [mesh_parts.draw(index, SEED) for index in reversed(range(12))] == first[::-1]
    assert [scene["object"]["mesh"].split()[0] for scene in first] == [*mesh_parts.KINDS] * 2
    assert first[0]["press"] == random_scenes.draw(0, SEED)["press"]
    assert first[0]["object"]["mesh"] in random_scenes.said(first[0])


@pytest.mark.parametrize("index", range(6))
def test_a_part_is_watertight_and_a_scene(index: int, tmp_path: Path) -> None:
    drawn = mesh_parts.draw(index, SEED)
    scene = mesh_parts.built(drawn, tmp_path)
    part = trimesh.load_mesh(scene.object.mesh)
    assert part.is_watertight and part.is_winding_consistent and part.volume > 0.0
    sizes = part.extents
    assert 2.0 < max(sizes) < 20.0 and min(sizes) > 1.0, sizes  # [mm]: on the gel, and no sheet
