"""The table of shapes: its geometry is whole, texts for people name every shape, and one added by the recipe is treated as its row says."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gelsim import console
from gelsim.data.motion import Motion
from gelsim.errors import SceneError
from gelsim.fem import recording as fem_recording
from gelsim.generate.plan import Catalogue, load_plan
from gelsim.generate.real import labels_of_name
from gelsim.generate.recording import expected_travel, record
from gelsim.geometry import enclosed_volume, is_closed
from gelsim.mesh.contact_area import footprint
from gelsim.mesh.profiles import mesh_profiles
from gelsim.mesh.reductions import choose_reduction
from gelsim.pipeline import stages
from gelsim.pipeline.sheet import describe_scene
from gelsim.results import Deformation
from gelsim.scene import definition
from gelsim.scene.definition import Body, Gel, Grains, Press, Scene, Skin, unread_sizes
from gelsim.scene.shape_table import SHAPES, Shape
from gelsim.shape.outlines import BORES, PLANES, PROFILES, UNDERSIDES, profile
from gelsim.shape.shapes import object_surface, project, shape_symmetry
from gelsim.shape.solids import Segment

ROOT = Path(__file__).parents[2]


def names(*made: str) -> set[str]:
    return {name for name, row in SHAPES.items() if row.made in made}


def test_every_row_has_its_geometry() -> None:
    assert set(PROFILES) == names("turned", "drawn") and set(PLANES) == names("planes") and set(UNDERSIDES) == names("relief")
    # a hollow is what may come to touch itself
    assert set(BORES) == {name for name in PROFILES if SHAPES[name].hollow}
    assert not any(SHAPES[name].convex or not SHAPES[name].wall for name in BORES)


def lists_of_shapes(source: str) -> list[int]:
    """Lines that say of shapes by name what a row should: a comparison of `….shape`, or two names or more side by side."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Compare) and isinstance(node.left, ast.Attribute) and node.left.attr == "shape":
            beside, enough = [part for other in node.comparators for part in ast.walk(other)], 1
        elif isinstance(node, ast.Dict | ast.Tuple | ast.List | ast.Set):
            beside, enough = node.keys if isinstance(node, ast.Dict) else node.elts, 2
        else:
            continue
        if isinstance(node, ast.Tuple) and any(isinstance(part, ast.Constant) and part.value == "dome" for part in beside):
            continue  # profiles of the gel
        if sum(isinstance(part, ast.Constant) and isinstance(part.value, str) and part.value in SHAPES for part in beside) >= enough:
            found.append(node.lineno)
    return found


def test_no_other_file_says_of_shapes_what_a_row_does() -> None:
    tables = {"scene/shape_table.py", "shape/outlines.py"}
    scenes = ("bench/", "study/")  # presses of certain shapes
    for folder in ("gelsim", "learn"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            name = path.relative_to(ROOT / folder).as_posix()
            if name not in tables and not name.startswith(scenes):
                assert lists_of_shapes(path.read_text(encoding="utf-8")) == [], path
    assert lists_of_shapes('HOLLOW = ("tube", "shell")') == lists_of_shapes('x = body.shape == "tube"') == [1]
    assert lists_of_shapes('SIZE = {"box": 1, "flat": 2}') == lists_of_shapes('if b.shape in ("tube",): pass') == [1]
    assert lists_of_shapes('("object", "mesh"); gel.profile in ("flat", "dome")') == []


def untold(shapes: dict[str, Shape], docs: dict[str, str], table: str) -> set[str]:
    """Shapes that the help or the page does not name where their row asks for it."""
    told = {
        "shape": shapes,
        **{size: [name for name, row in shapes.items() if size in row.sizes] for size in OTHERWISE},
    }
    missing = {name for key, wanted in told.items() for name in wanted if not re.search(rf"\b{name}\b", docs[key].lower())}
    return missing | {name for name in shapes if not re.search(rf"^\|.*`{name}`.*\|.*\|", table, re.MULTILINE)}


def test_texts_for_people_name_every_shape() -> None:
    docs, page = console.field_docs(definition)["Body"], (ROOT / "docs" / "meshing.md").read_text(encoding="utf-8")
    assert untold(SHAPES, docs, page) == set()
    assert untold(SHAPES | {"bullet": Shape("turned")}, docs, page) == {"bullet"}
    with_parts = re.search(r"are the object's\. For (.*?) \(", page, re.DOTALL)
    assert with_parts and set(re.split(r",\s+|\s+and\s+", with_parts[1])) == {name for name, row in SHAPES.items() if row.has_parts}


OTHERWISE = {"radius_mm": 6.0, "width_mm": 12.0, "length_mm": 13.0, "angle_deg": 80.0, "wall_mm": 1.3, "amplitude_mm": 0.3,
             "wavelength_mm": 4.0, "pattern_seed": 1}  # fmt: skip


@pytest.mark.parametrize("shape", [name for name, row in SHAPES.items() if row.made != "file"])
def test_the_sizes_of_a_row_are_those_that_change_the_shape(shape: str) -> None:
    def surface(**size: float) -> np.ndarray:
        return object_surface(Body(shape=shape, rigid=True, **size), edge_length=2e-3, chord=1e-4).vertices  # type: ignore[arg-type]

    plain = surface()
    assert {size for size, value in OTHERWISE.items() if not np.array_equal(surface(**{size: value}), plain)} == set(SHAPES[shape].sizes)


def test_a_size_that_is_not_read_is_told() -> None:
    assert unread_sizes(Body(shape="box", width_mm=4.0, radius_mm=5.0)) == []
    assert unread_sizes(Body(shape="box", wall_mm=1.0)) == ["object.wall_mm = 1.0 is not read: a box has height_mm, width_mm, length_mm"]


def bullet(body: Body) -> tuple[Segment, ...]:
    """A cone of 90 degrees, its flank as steep from its foot on as a rod's."""
    h, r = 1e-3 * body.height_mm, 1e-3 * body.radius_mm
    return Segment((0.0, 0.0), (r, r)), Segment((r, r), (r, h))


@pytest.fixture
def added(monkeypatch: pytest.MonkeyPatch) -> Shape:
    """A shape by the recipe of docs/extending.md: a row and a profile."""
    row = Shape("turned", sizes=("radius_mm",), has_parts=True, tip_mm=1.0, least_height=(1.0, 0.0), recorded_as=("bul",))
    monkeypatch.setitem(SHAPES, "bullet", row)
    monkeypatch.setitem(PROFILES, "bullet", bullet)
    return row


def scene_of(**body: object) -> Scene:
    return Scene(object=Body(shape="bullet", height_mm=12.0, **body), gel=Gel(profile="flat"), press=Press(depth_mm=0.5, force_n=1.0))  # type: ignore[arg-type]


def test_a_shape_added_by_the_recipe_is_a_solid(added: Shape) -> None:
    scene = scene_of(radius_mm=3.0)
    surface = object_surface(scene.object, edge_length=2e-3, chord=1e-6)
    assert is_closed(surface.faces) and surface.vertices[:, 2].min() == 0.0
    # chords of 1 µm inside a rod of R = 3 mm: less than 2/3 of 1 µm on a surface of 226 mm² and the cone's
    exact = np.pi * 9 * 3 / 3 + np.pi * 9 * 9
    assert exact - 0.001 * 226 < 1e9 * enclosed_volume(surface) < exact
    assert np.abs(project(scene.object, surface.vertices) - surface.vertices).max() < 1e-12
    assert shape_symmetry(scene.object) == {"x", "y"} and shape_symmetry(replace(scene.object, grains=Grains(1, shore_a=30))) == set()
    assert footprint(scene).round


WAIST = (Segment((0.0, 0.0), (3e-3, 3e-3), 3e-3), Segment((3e-3, 3e-3), (2e-3, 6e-3)), Segment((2e-3, 6e-3), (4e-3, 12e-3)))


@pytest.mark.parametrize(
    "segments, said",
    [
        ((WAIST[0], Segment((3e-3, 3.1e-3), (3e-3, 12e-3))), r"ends at \(3, 3\) mm, the next begins at \(3, 3.1\) mm"),
        ((Segment((0.0, 0.0), (3e-3, 3e-3), 4e-3),), r"an arc of 4 mm in its profile does not pass \(0, 0\) mm and \(3, 3\) mm"),
        (WAIST, r"not convex at \(2, 6\) mm; its row needs convex=False"),
        ((WAIST[0], Segment((3e-3, 3e-3), (5e-3, 5e-3), -2e-3, (5e-3, 3e-3))), r"not convex at \(3, 3\) mm"),
    ],
    ids=["gap", "off its circle", "waist", "hollow"],
)
def test_a_profile_that_is_none_or_not_as_its_row_says_is_refused(
    added: Shape, monkeypatch: pytest.MonkeyPatch, segments: tuple[Segment, ...], said: str
) -> None:
    """A forgotten convex=False made a force 12 % too large without a word; a gap filled memory for minutes."""
    monkeypatch.setitem(PROFILES, "bullet", lambda body: segments)
    with pytest.raises(SceneError, match=said):
        profile(scene_of().object)


def test_a_row_that_is_not_convex_may_have_a_waist(added: Shape, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PROFILES, "bullet", lambda body: WAIST)
    monkeypatch.setitem(SHAPES, "bullet", replace(added, convex=False))
    assert profile(scene_of().object) == WAIST


def test_a_shape_added_by_the_recipe_reduces_as_its_row_says(added: Shape, monkeypatch: pytest.MonkeyPatch) -> None:
    assert choose_reduction(scene_of()).kind == "axisymmetric"
    gel, body = mesh_profiles(scene_of())
    assert len(gel.triangles) and body.nodes[:, 0].max() == pytest.approx(5e-3)
    monkeypatch.setitem(SHAPES, "bullet", replace(added, convex=False))
    assert choose_reduction(scene_of()).kind == "mirror"
    monkeypatch.setitem(SHAPES, "bullet", replace(added, made="drawn"))
    with pytest.raises(SceneError, match="is none of "):
        choose_reduction(scene_of().replace(press=Press(symmetry="axisymmetric")))


def test_a_shape_added_by_the_recipe_is_told_of(added: Shape, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "bullet, R 4 mm" in describe_scene(scene_of(radius_mm=4.0))
    assert labels_of_name("bul4_30_1") | {"shape": "bullet", "group": 1, "radius_mm": 4.0} == labels_of_name("bul4_30_1")
    # a sharp tip goes deeper under the same force than one as flat as the table's default
    sharp = expected_travel(scene_of())
    monkeypatch.setitem(SHAPES, "bullet", replace(added, tip_mm=50.0))
    assert sharp > 1.2 * expected_travel(scene_of())


def test_a_shape_added_by_the_recipe_is_pressed_and_recorded(added: Shape, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(fem_recording, "closing_gap", lambda *_: (1, 0.1))  # wherever it is looked for it is found
    plan = (ROOT / "tests" / "plan_tiny.toml").read_text().replace('"hemisphere"', '"bullet"').replace("6.0", "4.0")
    (tmp_path / "plan.toml").write_text(plan)
    catalogue = Catalogue(load_plan(str(tmp_path / "plan.toml")), 0)
    drawn = next(press for press in map(catalogue.press, range(4)) if not press.scene.object.rigid)
    scene = drawn.scene.replace(press=Press(depth_mm=0.1, frames=2))

    def warnings(press: Deformation) -> list[str]:
        return [text for text in press.report.warnings if "comes to touch itself" in text]

    solved = stages.press(scene, device="cpu")
    row = record(catalogue, drawn, 0, Motion.of_press(solved), None).episode.row
    assert row["shape"] == "bullet" and row["radius_mm"] == 4.0 and warnings(solved) == []
    monkeypatch.setitem(SHAPES, "bullet", replace(added, hollow=True, sizes=()))
    assert record(catalogue, drawn, 0, Motion.of_press(solved), None).episode.row["radius_mm"] is None
    assert len(warnings(stages.press(scene, device="cpu"))) == 1


def test_a_shape_added_by_the_recipe_is_checked(added: Shape, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SceneError, match="a bullet needs more than 14 mm"):
        scene_of(radius_mm=14.0)
    skin = Skin(thickness_mm=0.5, shore_a=20.0)
    assert scene_of(skin=skin).object.skin == skin
    monkeypatch.setitem(SHAPES, "bullet", replace(added, skin={"thickness_mm": 0.5, "shore_a": 20.0}))
    assert scene_of().object.skin == skin
    monkeypatch.setitem(SHAPES, "bullet", replace(added, has_parts=False))
    with pytest.raises(SceneError, match="has none; allowed for flat"):
        scene_of(skin=skin)
    monkeypatch.setitem(SHAPES, "bullet", replace(added, least_soft_radius_mm=2.0))
    with pytest.raises(SceneError, match=r"soft bullet is 2 … 50 mm"):
        scene_of(radius_mm=1.5)
    monkeypatch.delitem(SHAPES, "bullet")
    with pytest.raises(SceneError, match="object.shape = 'bullet': allowed are"):
        scene_of()
