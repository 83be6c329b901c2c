"""Scenes to mesh, and what every mesh must be."""

import numpy as np

from gelsim.geometry import TetMesh, is_closed, jacobian_determinants, outer_faces, split_faces, tet_quality
from gelsim.scene.definition import Body, Gel, Press, Scene

QUIET = lambda line: None  # noqa: E731


def scene(shape: str, profile: str = "dome", **press: object) -> Scene:
    return Scene(object=Body(shape=shape, height_mm=12.0), gel=Gel(profile=profile), press=Press(**press), fidelity="fast")  # type: ignore[arg-type]


def assert_whole(mesh: TetMesh) -> None:
    """Right side out, closed, every face in one group or on a symmetry plane, its nodes exactly there."""
    assert jacobian_determinants(mesh.rest_positions, mesh.tets).min() > 0
    assert tet_quality(mesh.rest_positions, mesh.tets).min() > 0.02
    faces = outer_faces(mesh.tets)
    assert is_closed(split_faces(faces))
    named = [tuple(sorted(face)) for group in mesh.groups.values() for face in group]
    assert len(set(named)) == len(named)
    rest = np.array([face for face in faces if tuple(sorted(face)) not in set(named)]).reshape(-1, 6)
    assert len(rest) + len(named) == len(faces)
    on_plane = np.zeros(len(rest), bool)
    for axis in mesh.symmetry:
        on_plane |= (mesh.rest_positions[rest][:, :, "xy".index(axis)] == 0.0).all(axis=1)
        assert mesh.rest_positions[:, "xy".index(axis)].min() == 0.0
    assert on_plane.all()
