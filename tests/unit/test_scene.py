"""Scene files: layers, presets, and every way to get one wrong."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any, get_args, get_origin

import pytest

from gelsim.errors import MaterialError, SceneError
from gelsim.scene.definition import Body, Gel, LawConstants, Press, Scene
from gelsim.scene.expectation import Expected
from gelsim.scene.fields import field_types
from gelsim.scene.layers import build_scene, dump_scene, load_expectation, load_scene, preset_names, scene_table
from gelsim.scene.limits import LIMITS


def test_defaults_are_those_of_the_paper() -> None:
    scene = build_scene()
    assert (scene.gel.profile, scene.gel.thickness_mm, scene.gel.shore_00) == ("dome", 2.4, 17.0)
    assert (scene.object.shape, scene.object.shore_00) == ("cylinder", 30.0)
    assert (scene.camera.resolution, scene.camera.field_mm) == ((960, 720), (18.4, 13.8))


@pytest.mark.parametrize("name", ["digit", "fingertip2017", "gelsight_mini", "gelsight_mini_markers", "taxim"])
def test_presets_load(name: str) -> None:
    assert name in preset_names()
    assert build_scene({"sensor": {"preset": name}}).lights.lights


def test_written_scene_reads_back_equal(tmp_path: Path) -> None:
    scene = build_scene({"object": {"shape": "punch", "rigid": True}, "press": {"force_n": "none", "shear_mm": [0.1, -0.2]}})
    (tmp_path / "scene.toml").write_text(dump_scene(scene), encoding="utf-8")
    assert load_scene(tmp_path / "scene.toml") == scene


@pytest.mark.parametrize("path", sorted((Path(__file__).parents[2] / "scenes").glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_scenes_load(path: Path) -> None:
    load_scene(path)


def test_what_is_given_alone_is_reached() -> None:
    """Parts on `digit` ended at 0.19 to 0.47 mm of the 0.5 that were asked for, by the default force."""
    assert build_scene({}).press.force_n == 9.0 and build_scene({}).press.depth_mm == 1.0
    assert build_scene({"press": {"depth_mm": 0.5}}).press.force_n is None
    assert build_scene({"press": {"depth_mm": 0.5}}, {"press": {"force_n": 3.0}}).press.force_n == 3.0
    assert build_scene({"press": {"depth_mm": "None"}}).press.force_n == 9.0
    assert build_scene({"press": {"force_n": 2.0}}).press.depth_mm is None  # and a force alone, however deep
    assert build_scene({"press": {"force_n": "none"}}).press.depth_mm == 1.0
    whole = scene_table(build_scene({}))
    assert build_scene(whole, {"press": {"force_n": 2.0}}).press.depth_mm == 1.0
    assert build_scene(whole, {"press": {"depth_mm": 0.5}}).press.force_n == 9.0  # a scene that was written says both


def test_later_layer_beats_earlier_one() -> None:
    scene = build_scene({"press": {"depth_mm": 0.5, "frames": 4}}, {"press": {"depth_mm": 0.7}})
    assert (scene.press.depth_mm, scene.press.frames) == (0.7, 4)


def test_hardness_given_last_displaces_the_others() -> None:
    scene = build_scene({"object": {"shore_00": 20}, "gel": {"youngs_modulus_kpa": 50}}, {"object": {"shore_a": 45}})
    assert (scene.object.shore_00, scene.object.shore_a) == (None, 45.0)
    assert (scene.gel.shore_00, scene.gel.youngs_modulus_kpa) == (None, 50.0)  # the preset's 00-17 lies below


def test_constants_of_a_law() -> None:
    file = {"object": {"law": "yeoh", "law_constants": {"c2_over_c1": 0.05, "c3_over_c1": 0.002}}}
    constants = build_scene(file, {"object": {"law_constants": {"c2_over_c1": 0.1}}}).object.law_constants
    assert (constants.c2_over_c1, constants.c3_over_c1) == (0.1, 0.002)
    # another law has no use for them, the same one keeps them
    assert build_scene(file, {"object": {"law": "neo-hookean"}}).object.law_constants == LawConstants()
    assert build_scene(file, {"object": {"law": "yeoh"}}) == build_scene(file)
    ogden = build_scene(file, {"object": {"law": "ogden", "law_constants": {"alpha": [2.6]}}})
    assert ogden.object.law_constants == LawConstants(alpha=(2.6,))
    assert build_scene(tomllib.loads(dump_scene(ogden))) == ogden


def test_skin_and_grains_are_tables_of_the_object() -> None:
    file = {"object": {"skin": {"thickness_mm": 0.5, "shore_a": 30}, "grains": {"count": 3, "shore_00": 60}}}
    body = build_scene(file, {"object": {"skin": {"youngs_modulus_kpa": 800}}}).object
    assert (body.skin.thickness_mm, body.skin.shore_a, body.skin.youngs_modulus_kpa) == (0.5, None, 800.0)
    assert (body.grains.count, body.grains.radius_mm, body.shore_00) == (3, 1.0, 30.0)
    scene = build_scene(file)
    assert build_scene(tomllib.loads(dump_scene(scene))) == scene
    assert "skin" not in tomllib.loads(dump_scene(build_scene()))["object"]
    # what a tomato and a candy are made of unless told otherwise; a rigid one has only its shape
    tomato, candy = (build_scene({"object": {"shape": shape}}).object for shape in ("tomato", "candy"))
    assert (tomato.skin.thickness_mm, tomato.skin.shore_a, candy.grains.count, candy.grains.shore_a) == (0.5, 20.0, 20, 45.0)
    assert build_scene({"object": {"shape": "tomato", "rigid": True}}).object.skin == build_scene().object.skin


def test_preset_fills_and_file_overrides(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("[gel]\nthickness_mm = 3.0\nshore_00 = 25\n", encoding="utf-8")
    (tmp_path / "scene.toml").write_text('[sensor]\npreset = "mine.toml"\n[gel]\nthickness_mm = 3.5\n', encoding="utf-8")
    gel = load_scene(tmp_path / "scene.toml").gel  # the preset's path is relative to the scene file
    assert (gel.thickness_mm, gel.shore_00) == (3.5, 25.0)


def test_a_scene_of_relative_paths_is_the_same_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As of flags: what a result keeps as its scene.toml is read from the result's folder, or from anywhere."""
    (tmp_path / "mine.toml").write_text("[gel]\nthickness_mm = 3.0\n")
    monkeypatch.chdir(tmp_path)
    made = build_scene({"sensor": {"preset": "mine.toml"}, "object": {"shape": "mesh", "mesh": "part.stl"}})
    assert made.gel.thickness_mm == 3.0
    (tmp_path / "result").mkdir()
    (tmp_path / "result" / "scene.toml").write_text(dump_scene(made))
    monkeypatch.chdir(tmp_path / "result")
    assert load_scene("scene.toml") == made
    assert build_scene({"sensor": {"preset": "taxim"}}).sensor.preset == "taxim"  # a name is no path


def test_mesh_path_is_relative_to_the_scene_file(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text('[object]\nshape = "mesh"\nmesh = "part.stl"\n', encoding="utf-8")
    assert load_scene(tmp_path / "scene.toml").object.mesh == str((tmp_path / "part.stl").resolve())


def test_scene_made_in_python_is_checked_and_hashable() -> None:
    scene = Scene(object=Body(shore_a=45), press=Press(depth_mm=1))
    assert scene.object.shore_00 is None and isinstance(scene.press.depth_mm, float)
    assert hash(scene) == hash(scene.replace()) and scene.replace(press=Press(depth_mm=0.4)) != scene
    with pytest.raises(SceneError, match="press.frames"):
        scene.replace(press=replace(scene.press, frames=1))


BAD = {
    "unknown section": ('[objct]\nshape = "flat"', "unknown key 'objct'; did you mean 'object'"),
    "unknown key": ("[object]\nradius = 3", "unknown key 'object.radius'; did you mean 'radius_mm'"),
    "unknown key of a light": ("[[lights.lights]]\nnam = 'red'", "unknown key 'lights.lights.nam'; did you mean 'name'"),
    "unknown shape": ('[object]\nshape = "cylindre"', "did you mean 'cylinder'"),
    "negative radius": ("[object]\nradius_mm = -5", "object.radius_mm = -5 mm: allowed is"),
    "soft and small": ('[object]\nshape = "hemisphere"\nradius_mm = 1', "object.radius_mm = 1 mm: allowed for a soft hemisphere is 2.5"),
    "Shore 130": ("[object]\nshore_00 = 130", "object.shore_00: Shore 00 reading 130: allowed is 1 … 99"),
    "Shore A 10": ("[object]\nshore_a = 10", "object.shore_a: Shore A reading 10: allowed is 20 … 80; softer"),
    "two moduli": ("[object]\nshore_00 = 30\nyoungs_modulus_kpa = 100", "give exactly one of shore_00, shore_a, youngs_modulus_kpa"),
    "incompressible": ("[gel]\npoissons_ratio = 0.5", "gel.poissons_ratio = 0.5: allowed is 0 … 0.49999"),
    "depth beyond the object": ("[press]\ndepth_mm = 26", "press.depth_mm = 26 mm: it must be less than object.height_mm = 25 mm"),
    "depth beyond the gel": ("[press]\ndepth_mm = 2.3\n[object]\nrigid = true", "0.8 of gel.thickness_mm deep, 1.92 mm"),
    "no end": ('[press]\ndepth_mm = "none"\nforce_n = "none"', "both none"),
    "depth nan": ("[press]\ndepth_mm = nan", "press.depth_mm = nan: expected a finite number"),
    "frames": ("[press]\nframes = 1", "press.frames = 1: allowed is 2 … 1000"),
    "half a frame": ("[press]\nframes = 2.5", "press.frames = 2.5: expected a whole number"),
    "friction": ("[contact]\nfriction_coefficient = -0.1", "contact.friction_coefficient = -0.1: allowed is 0 … 10"),
    "friction word": ('[contact]\nfriction_coefficient = "glue"', '"stick"'),
    "beside the gel": ("[press]\noffset_mm = [0, 20]", "press.offset_mm = 20 mm along y"),
    "one number for two": ("[press]\ntilt_deg = [1]", "press.tilt_deg = [1]: expected a list of 2 values"),
    "text for a number": ('[gel]\nthickness_mm = "thick"', "gel.thickness_mm = 'thick': expected a number"),
    "true for a number": ("[gel]\nthickness_mm = true", "gel.thickness_mm = True: expected a number"),
    "number for a section": ("gel = 3", "gel = 3: expected a table, [gel]"),
    "resolution": ("[render]\nresolution = [8, 8]", "render.resolution = 8 8: allowed is 16 … 4096"),
    "samples": ("[render]\nspp = 0", "render.spp = 0: allowed is 1"),
    "dome thicker at its edge": ("[gel]\nedge_thickness_mm = 3", "gel.edge_thickness_mm = 3 mm"),
    "markers overlap": ("[markers]\nradius_mm = 0.7", "markers overlap"),
    "mesh without a file": ('[object]\nshape = "mesh"', "object.mesh is missing"),
    "file without mesh": ('[object]\nshape = "box"\nmesh = "a.stl"', 'say shape = "mesh"'),
    "preset": ('[sensor]\npreset = "fingertip2018"', "did you mean 'fingertip2017'"),
    "infinite light": ("[[lights.lights]]\npower = inf", "lights.lights.power = inf: expected a finite number"),
    "far light": ("[[lights.lights]]\nposition_mm = [0, 0, -1e9]", "lights.lights.position_mm = 0 0 -1e+09 mm: allowed is -1000"),
    "colour of 8 bits": ("[[lights.lights]]\nrgb = [255, 13, 5]", "lights.lights.rgb = 255 13 5: allowed is 0 … 10"),
    "negative colour": ("[[lights.lights]]\nrgb = [1, -0.1, 0]", "lights.lights.rgb = 1 -0.1 0: allowed is 0 … 10"),
    "black light": ("[[lights.lights]]\nrgb = [0, 0, 0]", "lights.lights.rgb = 0 0 0 is no colour: give one above 0; a light that is off"),
    "light outside": (
        '[[lights.lights]]\nname = "top"\nposition_mm = [0, 0, 3]',
        "light 1 of 1, 'top': lights.lights.position_mm has z = 3 mm",
    ),
    "light without direction": ("[[lights.lights]]\ndirection = [0, 0, 0]", "lights.lights.direction = 0 0 0 points nowhere"),
    "camera in the window": ("[camera]\ndistance_mm = 5", "camera.distance_mm = 5 mm: the camera stands behind window and gel"),
    "law": ('[object]\nlaw = "neohookean"', "did you mean 'neo-hookean'"),
    "law without constants": ('[object]\nlaw = "yeoh"', "object.law_constants.c2_over_c1 is missing"),
    "law without one constant": (
        '[object]\nlaw = "yeoh"\nlaw_constants = {c2_over_c1 = 0.1}',
        "object.law_constants.c3_over_c1 is missing",
    ),
    "no exponent": ('[object]\nlaw = "ogden"', "object.law_constants.alpha is missing"),
    "unknown constant": ('[object]\nlaw = "yeoh"\nlaw_constants = {c2_by_c1 = 0.1}', "did you mean 'c2_over_c1'"),
    "constant of another law": ("[object]\nlaw_constants = {alpha = [3]}", 'alpha is a constant of law = "ogden", but law = "neo-hookean"'),
    "constants that are none": ("[object]\nlaw_constants = 3", "object.law_constants = 3: expected a table"),
    "skin without hardness": ("[object.skin]\nthickness_mm = 1", "object.skin has no hardness: give exactly one of"),
    "hardness of no skin": ("[object.skin]\nshore_a = 30", "object.skin.shore_a = 30, but object.skin.thickness_mm = 0: give thickness_mm"),
    "grains of two hardnesses": ("[object.grains]\ncount = 3\nshore_a = 30\nshore_00 = 20", "give exactly one of shore_00, shore_a"),
    "grains too hard": ("[object.grains]\ncount = 3\nshore_a = 95", "object.grains.shore_a: Shore A reading 95: allowed is 20"),
    "skin of a file": (
        '[object]\nshape = "mesh"\nmesh = "a.stl"\nskin = {thickness_mm = 1, shore_a = 30}',
        'object.skin.thickness_mm = 1: shape = "mesh" has none; allowed for flat',
    ),
    "unknown key of a skin": ("[object.skin]\nthickness = 1", "unknown key 'object.skin.thickness'; did you mean 'thickness_mm'"),
    "shares without times": ("[gel]\nprony_g = [0.1]", "gel.prony_g has 1 values, prony_tau_s 0"),
    "shares of everything": ("[object]\nprony_g = [0.5, 0.5]\nprony_tau_s = [1, 2]", "object.prony_g sums to 1: it must stay below 1"),
    "share of nothing": ("[object]\nprony_g = [0]\nprony_tau_s = [1]", "object.prony_g = 0: a share must be positive"),
    "path beside a depth": ("[press]\ndepth_mm = 0.5\npath = [{force_n = 1}]", "press.depth_mm = 0.5: press.path says the motion"),
    "waypoint of depth and force": ("[press]\npath = [{force_n = 1, depth_mm = 1}]", "waypoint 1 of 1: press.path.depth_mm = 1 mm and"),
    "waypoint too deep": (
        "[object]\nrigid = true\n[press]\npath = [{depth_mm = 0.1}, {depth_mm = 2}]",
        "waypoint 2 of 2: press.path.depth_mm = 2 mm: a",
    ),
    "more waypoints than frames": (
        "[press]\nframes = 2\npath = [{depth_mm = 0.1}, {depth_mm = 0}]",
        "press.frames = 2: a path of 2 waypoints",
    ),
    "unknown key of a waypoint": ("[press]\npath = [{depth = 0.1}]", "unknown key 'press.path.depth'; did you mean 'depth_mm'?"),
    "several forces and a depth": ("[press]\ndepth_mm = 0.5\nforce_n = [1, 2]", "press.force_n = [1, 2]: several forces are a path"),
    "no measured path": ('[press]\npath_csv = "none.csv"', "press.path_csv = "),
    "wall thicker than the tube": (
        '[object]\nshape = "tube"\nwall_mm = 6',
        "object.wall_mm = 6 mm: allowed for a tube of that",
    ),
    "tube without a foot": ('[object]\nshape = "tube"\nheight_mm = 8', "object.height_mm = 8 mm: a tube needs more than 9 mm"),
    "waves too steep": ('[object]\nshape = "rough"\namplitude_mm = 2', "object.amplitude_mm = 2 mm: allowed is up to 1.43 mm"),
    "exponent zero": ('[object]\nlaw = "ogden"\nlaw_constants = {alpha = [0.01]}', "object.law_constants.alpha = 0.01: its size must"),
    "exponent too large": ('[object]\nlaw = "ogden"\nlaw_constants = {alpha = [99]}', "object.law_constants.alpha = 99: allowed is -25"),
    "weights missing": ('[object]\nlaw = "ogden"\nlaw_constants = {alpha = [2, 3]}', "object.law_constants.weight is missing"),
    "weights of another sum": (
        '[object]\nlaw = "ogden"\nlaw_constants = {alpha = [2, 3], weight = [0.5, 0.4]}',
        "object.law_constants.weight sums to 0.9",
    ),
    "law that gives way": (
        '[object]\nlaw = "yeoh"\nlaw_constants = {c2_over_c1 = -0.3, c3_over_c1 = 0.01}',
        "object.law_constants.c2_over_c1 = -0.3: the law gives way",
    ),
}


def number_fields(kind: type, name: str = "") -> Iterator[tuple[str, Any]]:
    """Full name and type of every field of a scene that holds numbers."""
    for key, hint in field_types(kind).items():
        full = f"{name}.{key}" if name else key
        hint = next((option for option in get_args(hint) if get_origin(option) is tuple), hint)  # of two numbers, or none
        inner = next(iter(get_args(hint)), None)
        if is_dataclass(hint) or is_dataclass(inner):
            yield from number_fields(hint if is_dataclass(hint) else inner, full)  # type: ignore[arg-type]
        elif any(number in (hint, *get_args(hint)) for number in (float, int)):
            yield full, hint


def test_every_number_is_bounded() -> None:
    unbounded = [name for name, _ in number_fields(Scene) if name not in LIMITS and name.split(".")[-1] not in ("shore_00", "shore_a")]
    assert unbounded == []
    assert sorted(set(LIMITS) - {name for name, _ in number_fields(Scene)}) == []


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_none_are_refused_in_every_field(wrong: float) -> None:
    for name, hint in number_fields(Scene):
        value: Any = [wrong] * len(get_args(hint)) if get_origin(hint) is tuple else wrong
        *sections, key = name.split(".")
        layer: Any = {key: value}
        if sections in (["lights", "lights"], ["press", "path"]):
            layer = {sections[0]: {sections[1]: [layer]}}
        else:
            for section in reversed(sections):
                layer = {section: layer}
        # A whole number is refused for its type, the others because they are not finite.
        with pytest.raises(SceneError, match=rf"{name} = {wrong}: expected a"):
            build_scene(layer)


@pytest.mark.parametrize("name", BAD)
def test_wrong_scene_is_one_clear_line(name: str) -> None:
    text, expected = BAD[name]
    with pytest.raises((SceneError, MaterialError)) as caught:
        build_scene(tomllib.loads(text))
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


WRONG_SENSOR = {
    "unit": ("[camera]\ndistance_mm = 5000", "camera.distance_mm = 5000 mm: allowed is 1 … 1000 mm"),
    "contradiction": (
        "[camera]\ndistance_mm = 5",
        "camera.distance_mm = 5 mm: the camera stands behind window and gel, so it must exceed 6.4 mm",
    ),
    "hardness": ("[gel]\nshore_00 = 130", "gel.shore_00: Shore 00 reading 130: allowed is 1 … 99"),
    "section": ("[object]\nradius_mm = 3", "'object' does not belong in a sensor preset: it fills gel, camera, lights, coating, markers"),
    "key": ("[camera]\ndistance = 5", "unknown key 'camera.distance'; did you mean 'distance_mm'?"),
    "type in the second light": (
        '[[lights.lights]]\nname = "a"\n[[lights.lights]]\nname = "b"\npower = "much"',
        "light 2 of 2, 'b': lights.lights.power = 'much': expected a number",
    ),
    "key in a light without a name": (
        "[[lights.lights]]\n[[lights.lights]]\n[[lights.lights]]\nrbg = [1, 0, 0]",
        "light 3 of 3: unknown key 'lights.lights.rbg'; did you mean 'rgb'?",
    ),
    "colour of the first light": (
        '[[lights.lights]]\nname = "a"\nrgb = [13, 255, 13]\n[[lights.lights]]\nname = "b"',
        "light 1 of 2, 'a': lights.lights.rgb = 13 255 13: allowed is 0 … 10",
    ),
}


@pytest.mark.parametrize("name", WRONG_SENSOR)
def test_an_error_in_a_sensor_file_names_it_and_the_light(name: str, tmp_path: Path) -> None:
    text, expected = WRONG_SENSOR[name]
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    preset = str(tmp_path / "mine.toml")
    with pytest.raises((SceneError, MaterialError)) as caught:
        build_scene({"sensor": {"preset": preset}})
    assert str(caught.value) == f"sensor preset {preset!r}: {expected}"


def test_what_a_scene_gets_wrong_is_not_blamed_on_its_sensor(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("[camera]\ndistance_mm = 5\n", encoding="utf-8")
    sensor = {"preset": str(tmp_path / "mine.toml")}
    assert build_scene({"sensor": sensor, "camera": {"distance_mm": 30}}).camera.distance_mm == 30
    with pytest.raises(SceneError, match="^camera.distance_mm = 6 mm"):
        build_scene({"sensor": sensor, "camera": {"distance_mm": 6}})


def test_unreadable_files_are_scene_errors(tmp_path: Path) -> None:
    (tmp_path / "broken.toml").write_text("[gel\n", encoding="utf-8")
    for path in (tmp_path / "missing.toml", tmp_path / "broken.toml", tmp_path):
        with pytest.raises(SceneError, match="cannot be read|is not TOML"):
            load_scene(path)


def test_small_rigid_ball_is_allowed() -> None:
    Scene(object=Body(shape="hemisphere", radius_mm=1.0, rigid=True), gel=Gel(profile="flat"), press=Press(depth_mm=0.3))


EXPECT = '[object]\nshape = "flat"\n[expect]\nforce_n = { value = 2.0, spread = 0.01, margin = 0.1 }\n'


def test_what_is_expected_is_no_part_of_the_scene(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(EXPECT, encoding="utf-8")
    scene = load_scene(tmp_path / "scene.toml")
    assert scene == build_scene({"object": {"shape": "flat"}}) and "expect" not in dump_scene(scene)
    assert load_expectation(tmp_path / "scene.toml").numbers() == {"force_n": Expected(2.0, 0.01, 0.1)}
    with pytest.raises(SceneError, match="unknown key 'expect'"):  # of a file alone
        build_scene(tomllib.loads(EXPECT))


@pytest.mark.parametrize(
    ("right", "wrong", "told"),
    [
        ("force_n", "force", "unknown key 'expect.force'; did you mean 'force_n'"),
        (", margin = 0.1", "", "expect.force_n = .*expected"),
        ("margin = 0.1", "margin = nan", "expect.force_n.margin = nan: expected a finite number"),
        ("margin = 0.1", "margin = 0.0", "expect.force_n.spread = 0.01, margin = 0: allowed"),
    ],
)
def test_expectation_that_cannot_be_read_is_refused(tmp_path: Path, right: str, wrong: str, told: str) -> None:
    (tmp_path / "scene.toml").write_text(EXPECT.replace(right, wrong), encoding="utf-8")
    for read in (load_scene, load_expectation):
        with pytest.raises(SceneError, match=told):
            read(tmp_path / "scene.toml")
