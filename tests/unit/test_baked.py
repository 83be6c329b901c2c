"""Pictures from a light field: what a pixel sees, the table's kernel, shadows, inter-reflection, markers. Fields by formula, no bake."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_lightfield import linear_field, linear_value
from test_optics import imaged_centroids

from gelsim.data.lightfield import LightField
from gelsim.errors import RenderError
from gelsim.membrane.surface import rest_membrane
from gelsim.optics import baked, choose_variant
from gelsim.optics.arrays import NumPyArrays, choose_arrays
from gelsim.optics.baked import BakedRenderer, straight_rays
from gelsim.optics.camera import height_map, project
from gelsim.optics.lighting import light_pose
from gelsim.optics.probes import pressed_membrane
from gelsim.optics.variant import SCALAR
from gelsim.results import Membrane
from gelsim.scene.definition import Camera, Coating, Gel, Light, Lights, Markers, Render, Scene

VARIANTS = [SCALAR] if choose_variant("cpu").name == SCALAR.name else [SCALAR, choose_variant("cpu")]


def flat_scene(**sections) -> Scene:
    """A flat gel of 8 mm, one light far to the right, 20 degrees up; no markers, no grain."""
    light = Light("right", (30.0, 0.0, -11.0), (-30.0, 0.0, 11.0), (6.0, 1.0), power=50.0)
    parts = {
        "gel": Gel(profile="flat", size_mm=(8.0, 8.0)),
        "camera": Camera(field_mm=(6.0, 4.5)),
        "lights": Lights((light,)),
        "coating": Coating(specular=0.0),
        "markers": Markers(layout="none"),
        "render": Render("baked", resolution=(160, 120)),
    }
    return Scene(**(parts | sections))


def even_field(value: float = 1.0) -> LightField:
    """The same light everywhere, for every normal."""
    field = linear_field()
    table = np.zeros_like(field.table)
    table[..., 0] = value
    return replace(field, table=table)


def shift(points: np.ndarray) -> np.ndarray:
    """A bell of 0.6 mm that also drags the material sideways by up to 0.25 mm."""
    bell = np.exp(-(points[:, 0] ** 2 + points[:, 1] ** 2) / (2 * (0.9e-3) ** 2))[:, None]
    return points + bell * np.array([0.25e-3, -0.15e-3, -0.6e-3])


def dragged(scene: Scene) -> Membrane:
    rest = rest_membrane(scene)
    positions = shift(rest.positions)
    side = int(np.sqrt(len(positions)))
    along_y, along_x = np.gradient(positions.reshape(side, side, 3), axis=(0, 1))
    normals = np.cross(along_x, along_y).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Membrane(positions, normals, rest.uv, rest.faces, shift(rest.marker_centres))


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: v.name)
def test_tilted_plane_shows_the_table(variant):
    """A plane z = -1 + 0.2 x - 0.1 y: points by intersecting rays with it, normals by hand."""
    scene = flat_scene()
    rest = rest_membrane(scene)
    membrane = pressed_membrane(rest, 1e-3 - 0.2 * rest.positions[:, 0] + 0.1 * rest.positions[:, 1])
    picture, height = BakedRenderer(scene, linear_field(), variant, shadows=False, indirect=False).picture(membrane)
    column, row = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    ax, ay, bx, by = straight_rays(scene, column.ravel(), row.ravel()).T
    z = (-1 + 0.2 * ax - 0.1 * ay) / (1 - 0.2 * bx + 0.1 * by)
    normal = np.array([-0.2, 0.1, 1.0]) / np.sqrt(1.05)
    points = np.column_stack([ax + bx * z, ay + by * z, z])
    expected = linear_value(points, np.tile(normal, (len(points), 1)))
    # float32: places of 4 mm by grid index (100 cells) lose 1e-7 * 100 cells = 1e-6 mm; values of 10 lose 1e-6 a term.
    assert np.abs(height.ravel() * 1e3 - z).max() < 2e-5
    assert np.abs(picture[..., 0].ravel() - expected).max() < 1e-4
    assert np.array_equal(picture[..., 0], picture[..., 1])
    # Planted: the picture mirrored.
    assert np.abs(picture[::-1, :, 0].ravel() - expected).max() > 0.1


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: v.name)
def test_heights_are_those_of_the_triangles(variant):
    scene = flat_scene()
    membrane = dragged(scene)
    _, height = BakedRenderer(scene, even_field(), variant, shadows=False, indirect=False).picture(membrane)
    # Bilinear patches against triangles: h² u_xy / 4 = 0.08² 0.6/0.81/e / 4 mm = 0.4 µm, more where slopes of 0.4 carry it sideways.
    assert np.abs(height - height_map(scene, membrane)).max() < 1e-6


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: v.name)
def test_light_between_pixels_is_that_of_each(variant, monkeypatch):
    """Where pixels are finer than LIT_MM light is drawn for some of them: here one in 3 along a side, each 19 µm wide."""
    scene = flat_scene(camera=Camera(field_mm=(3.0, 2.25)))
    membrane, steps = dragged(scene), []

    def drawn(lit_mm: float) -> tuple[np.ndarray, np.ndarray]:
        monkeypatch.setattr(baked, "LIT_MM", lit_mm)
        renderer = BakedRenderer(scene, linear_field(), variant, indirect=False, shadows=False)
        picture, height = renderer.picture(membrane)
        assert renderer._layout is not None
        steps.append(renderer._layout.lit)
        return picture[..., 0].astype(float), height

    (fine, height), (some, same) = drawn(1e-6), drawn(0.06)
    assert steps == [1, 3] and np.array_equal(height, same)
    # Between values `h` apart a line is off by h²/8 of the second derivative, along each side; that is the largest of any neighbour's.
    # Normals are bilinear in cells of 0.08 mm: at a kink, twice what a parabola has.
    bend = sum(np.abs(np.diff(fine, 2, axis=axis)).max() for axis in (0, 1))
    inner = (slice(3, -3), slice(3, -3))
    assert np.abs(some - fine)[inner].max() < 2 * 9 / 8 * bend
    # Planted: light a pixel aside.
    assert np.abs(np.roll(some, 1, axis=1) - fine)[inner].max() > 2 * 9 / 8 * bend


def test_no_gel_no_light():
    scene = flat_scene(camera=Camera(field_mm=(12.0, 9.0)))
    picture, height = BakedRenderer(scene, even_field(), SCALAR, indirect=False).picture(rest_membrane(scene))
    assert np.isnan(height[60, 5]) and np.all(picture[60, 5] == 0) and height[60, 80] == 0 and picture[60, 80, 0] == 1


def test_a_membrane_without_a_grid_is_refused():
    scene = flat_scene()
    rest = rest_membrane(scene)
    odd = Membrane(rest.positions[1:], rest.normals[1:], rest.uv[1:], rest.faces, rest.marker_centres)
    with pytest.raises(RenderError, match="grid"):
        BakedRenderer(scene, even_field(), SCALAR).radiance(odd)


def ridge(scene: Scene) -> Membrane:
    """A ridge along y, 0.8 mm high on the camera's side and 0.3 mm wide."""
    rest = rest_membrane(scene)
    return pressed_membrane(rest, 0.8e-3 * np.exp(-((rest.positions[:, 0] - 0.5e-3) ** 2) / (2 * (0.3e-3) ** 2)))


def visible_by_hand(scene: Scene, x: float, count: int = 41) -> float:
    """Share of the light's rows that the point (x, 0, surface) sees, each weighed by its cosine there, over that without the ridge.

    A march along each ray in float64 over the ridge's formula; the light's long side counts as its middle, for the ridge is long.
    """
    pose = light_pose(scene.lights.lights[0])

    def height(x):
        return -0.8 * np.exp(-((x - 0.5) ** 2) / (2 * 0.3**2))

    z = height(x)
    slope = -z * (x - 0.5) / 0.3**2
    seen = whole = 0.0
    for share in (np.arange(count) + 0.5) / count * 2 - 1:
        source = pose[:3, 3] + share * pose[:3, 1]
        t = np.linspace(1e-3, 0.3, 4000)
        path = x + t * (source[0] - x), z + t * (source[2] - z)
        # Toward the light is down (z < 0): the cosine of the surface's inner normal (slope, -1).
        cosine = max((source[0] - x) * slope - (source[2] - z), 0.0)
        whole += cosine
        seen += cosine * bool(np.all(path[1] < height(path[0])))
    return seen / whole if whole else np.nan


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: v.name)
def test_shadow_of_a_ridge(variant, monkeypatch):
    scene = flat_scene()
    membrane = ridge(scene)
    picture, _ = BakedRenderer(scene, even_field(), variant, indirect=False).picture(membrane)
    row = 60
    points = straight_rays(scene, np.arange(160) + 0.5, np.full(160, row + 0.5))
    # Behind the ridge (left of it) and before it, where the surface is flat within 3 µm.
    columns = [c for c in range(4, 156, 2) if abs(points[c, 0] - 0.5) > 1.0]
    x = points[columns, 0]
    expected = np.array([visible_by_hand(scene, place) for place in x])
    assert expected.min() == 0 and expected.max() == 1
    edge = np.interp(0.5, expected[x < 0][::-1], x[x < 0][::-1])

    def edge_shift(drawn: np.ndarray) -> float:
        found = drawn[row, columns, 0]
        return abs(np.interp(0.5, found[x < 0][::-1], x[x < 0][::-1]) - edge)

    # Linear cells of 0.1 mm cut the ridge's top by at most 0.1² 0.8 / 0.3² / 8 = 0.011 mm: the shadow ends up to 0.03 mm early; steps of
    # 0.05 mm along a line 0.01 mm more, and one shadow value serves 3 pixels, 0.11 mm.
    assert edge_shift(picture) < 0.03 + 0.01 + 0.11 / 2
    found = picture[row, columns, 0]
    assert found[x < edge - 0.3].min() > 0.99 and found[(x > edge + 0.3) & (x < 0)].max() < 0.01 and found[x > 1].min() > 0.99
    # Planted: the light 5 degrees higher; on the other side.
    for place in ((30.0, 0.0, -14.0), (-30.0, 0.0, -11.0)):
        light = replace(scene.lights.lights[0], position_mm=place, direction=(-place[0], 0.0, -place[2]))
        wrong = BakedRenderer(scene.replace(lights=Lights((light,))), even_field(), variant, indirect=False).radiance(membrane)
        assert edge_shift(wrong) > 0.095
    # Planted: heights on a grid of 0.2 mm, which cut the top four times as much.
    monkeypatch.setattr(baked, "FINE_CELL", 0.2)
    assert edge_shift(BakedRenderer(scene, even_field(), variant, indirect=False).radiance(membrane)) > 1.5 * edge_shift(picture)


def test_a_lamp_behind_the_middle_has_distances_like_others():
    """Its middle piece lies in no direction from the gel's centre; the places where its shadows are sought ran through distance 0."""
    behind = Light("behind", (0.0, 0.0, -40.0), (0.0, 0.0, 1.0), (6.0, 6.0))
    pieces = baked.light_pieces(flat_scene(lights=Lights((behind,))))
    assert np.isfinite(pieces).all() and np.hypot(pieces[:, 4], pieces[:, 5]) == pytest.approx(1.0)
    farthest = pieces[:, 8] + (baked.STEPS - 1) / pieces[:, 9]
    assert (pieces[:, 8] > 0).all() and (farthest >= np.hypot(4.0, 4.0)).all()  # all of the gel


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: v.name)
def test_light_from_a_long_ramp(variant):
    """Beside a ramp that shines everywhere with L = 1 the horizontal surface receives E/π = (1 - cos α)/2, α the ramp's elevation."""
    scene = flat_scene(gel=Gel(profile="flat", size_mm=(30.0, 30.0)))
    rest = rest_membrane(scene)
    # Flat to the right of x = 0; to the left it rises at 45 degrees to 1.5 mm.
    membrane = pressed_membrane(rest, np.clip(-rest.positions[:, 0], 0, 1.5e-3))
    field = replace(even_field(), gains=np.array([1.0, 0.5, 0.0], np.float32))
    picture, _ = BakedRenderer(scene, field, variant, shadows=False).picture(membrane)
    points = straight_rays(scene, np.arange(160) + 0.5, np.full(160, 60.5))
    columns = [c for c in range(160) if 0.5 < points[c, 0] < 2.5]
    found = np.array([picture[60, c, 0] - 1 for c in columns])
    expected = np.array([(1 - np.cos(np.arctan2(1.5, points[c, 0] + 1.5))) / 2 for c in columns])
    # With every cell along 32 directions within 3 %. Of the samples taken the last before the ramp's top lies up to a fifth of its distance
    # before it: rise over distance, and with it E ~ α², is short by up to that, never long by more than the directions' 5 %.
    assert np.all(found / expected > 0.75) and np.all(found / expected < 1.05)
    # Planted: the ramp twice as high.
    twice = (1 - np.cos(np.arctan2(3.0, points[columns, 0] + 3.0))) / 2
    assert np.any(found / twice < 0.75)
    assert np.allclose(picture[..., 1] - 1, 0.5 * (picture[..., 0] - 1), atol=1e-6) and np.all(picture[..., 2] == 1)


def marked_scene() -> Scene:
    return flat_scene(markers=Markers(radius_mm=0.12, jitter_mm=0.1, tilt_deg=5.0, seed=3))


def centroid_errors(expected: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """Distance [px] of each wholly visible marker's centroid from where it is expected; inf where there is none. Unmarked light is 1."""
    covered = 1 - picture[..., 0]
    rows, columns = np.mgrid[: covered.shape[0], : covered.shape[1]] + 0.5
    errors = []
    for column, row in expected:
        if 10 < column < covered.shape[1] - 10 and 10 < row < covered.shape[0] - 10:
            near = np.hypot(columns - column, rows - row) < 9
            weights = covered[near]
            place = weights @ columns[near] / weights.sum() - column, weights @ rows[near] / weights.sum() - row
            errors.append(np.hypot(*place) if weights.sum() > 16 else np.inf)
    return np.array(errors)


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: v.name)
def test_markers_lie_where_projection_says(variant, monkeypatch):
    scene = marked_scene()
    draw = BakedRenderer(scene, even_field(), variant, shadows=False, indirect=False)
    rest = rest_membrane(scene)
    flat = draw.radiance(rest)
    centres = project(scene, rest.marker_centres)
    # Demanded: 0.05 px. A disc at rest: the projection of its centre, less the perspective's 1e-3 px.
    errors = centroid_errors(centres, flat)
    assert len(errors) >= 6 and errors.max() < 0.05
    # In a bent surface a disc's middle is not its centre's image (up to 0.1 px here).
    bent = draw.radiance(dragged(scene))
    assert centroid_errors(imaged_centroids(scene, shift), bent).max() < 0.05
    # Planted: the texture two fifths of a texel off (0.27 px); a marker missing.
    texture, texels = baked.coat_texture(scene)
    middle = [int((place / 8e-3 + 0.5) * count) for place, count in zip(rest.marker_centres[len(centres) // 2], texels, strict=False)]
    missing = texture.copy()
    missing[middle[1] - 9 : middle[1] + 10, middle[0] - 9 : middle[0] + 10] = [1, 0]
    for spoiled in (0.6 * texture + 0.4 * np.roll(texture, 1, axis=1), missing):
        monkeypatch.setattr(baked, "coat_texture", lambda scene, spoiled=spoiled: (spoiled.astype(np.float32), texels))
        wrong = BakedRenderer(scene, even_field(), variant, shadows=False, indirect=False)
        assert centroid_errors(centres, wrong.radiance(rest)).max() > 0.05


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: v.name)
@pytest.mark.parametrize("markers", [Markers(jitter_mm=0.08, seed=5), Markers(layout="none")], ids=["other markers", "none"])
def test_a_renderer_like_another_draws_the_same(variant, markers):
    """What one episode's renderer hands to the next changes no bit, and what is the next one's own is not handed over."""
    scene = marked_scene()
    first = BakedRenderer(scene, linear_field(), variant)
    drawn = first.radiance(dragged(scene))
    brighter = replace(first._field, colours=1.5 * first._field.colours)
    other = scene.replace(markers=markers, coating=replace(scene.coating, grain=0.01))
    alone = BakedRenderer(other, brighter, variant).radiance(dragged(other))
    assert np.array_equal(BakedRenderer(other, brighter, variant, like=first).radiance(dragged(other)), alone)
    assert not np.array_equal(alone, drawn)
    # Another table of light is no such scene: nothing of the first is used.
    darker = replace(brighter, table=0.5 * brighter.table)
    both = [BakedRenderer(other, darker, variant, like=like).radiance(dragged(other)) for like in (None, first)]
    assert np.array_equal(both[0], both[1]) and not np.array_equal(both[0], alone)


@pytest.mark.skipif(len(VARIANTS) < 2, reason="NumPy traces nothing")
def test_renderers_like_each_other_are_traced_once(monkeypatch):
    """Planted: without `like` each is traced."""
    traced, draw = [], baked.draw
    monkeypatch.setattr(baked, "draw", lambda *arguments: traced.append(1) or draw(*arguments))
    scene, field = marked_scene(), linear_field()
    membrane, last = rest_membrane(scene), None
    for seed in range(8):
        other = scene.replace(markers=replace(scene.markers, seed=seed))
        last = BakedRenderer(other, field, VARIANTS[1], like=last)
        last.frames([membrane] * 2)
    assert len(traced) == 1
    BakedRenderer(other, field, VARIANTS[1]).frames([membrane] * 2)
    assert len(traced) == 2


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda variant: variant.name)
def test_a_launch_of_any_number_of_frames_is_those_frames(variant):
    """Planted: one recording for all numbers of frames gives one frame of three, or ends the process."""
    scene = marked_scene()
    membranes = [dragged(scene), ridge(scene), rest_membrane(scene)]
    renderer = BakedRenderer(scene, linear_field(), variant)
    alone = [renderer.picture(membrane) for membrane in membranes]
    for first in (0, 1, 2):
        together = renderer.pictures(membranes[first:])
        assert len(together) == len(membranes) - first
        for (radiance, height), (one, z) in zip(together, alone[first:], strict=True):
            assert np.array_equal(radiance, one) and np.array_equal(height, z, equal_nan=True)


def test_means_over_boxes_and_values_between_texels():
    values = np.random.default_rng(6).random(50).astype(np.float32)
    box, step = 3.7, 2.3
    means = baked._box_means(50, box, step) @ values
    integral = np.concatenate([[0.0], np.cumsum(values)])
    centres = (np.arange(22) + 0.5) * 50 / 22
    ends = np.clip([centres - box / 2, centres + box / 2], 0, 50)
    between = [np.interp(end, np.arange(51), integral) for end in ends]
    # Five float32 products of numbers below 1.
    assert means == pytest.approx((between[1] - between[0]) / (ends[1] - ends[0]), abs=5e-7)
    fine = baked._linear_sampling(50, 90) @ values
    assert fine == pytest.approx(np.interp((np.arange(90) + 0.5) / 1.8 - 0.5, np.arange(50), values), abs=5e-7)


def test_running_minimum_is_the_same_by_both():
    values = np.random.default_rng(3).integers(0, 9, 7 * 50).astype(np.float32)
    kept = np.arange(7 * 50, dtype=np.float32)
    found = []
    for variant in VARIANTS:
        arrays = choose_arrays(variant)
        found.append(arrays.numpy(arrays.running_minimum(arrays.floats(values), arrays.floats(kept), 7, 50)).reshape(50, 7, 2))
    for step in range(50):
        lines = values.reshape(50, 7)[: step + 1]
        assert np.array_equal(found[0][step, :, 0], lines.min(axis=0))
        assert np.array_equal(found[0][step, :, 1], lines.argmin(axis=0) * 7 + np.arange(7))
    assert all(np.array_equal(one, found[0]) for one in found)


@pytest.mark.skipif(len(VARIANTS) == 1, reason="no vectorised variant here")
def test_both_backends_draw_the_same():
    scene = marked_scene()
    field = replace(linear_field(), gains=np.array([0.5, 0.4, 0.3], np.float32), veil=np.full((5, 6, 4), 0.2, np.float32))
    pictures = [BakedRenderer(scene, field, variant).pictures([dragged(scene), ridge(scene)]) for variant in VARIANTS]
    for one, other in zip(*pictures, strict=True):
        # A horizon may fall on the other side of a cell by rounding: rare pixels; float32 otherwise.
        difference = np.abs(one[0] - other[0]).max(axis=2)
        assert np.quantile(difference, 0.995) < 1e-3 and difference.max() < 1
        assert np.nanmax(np.abs(one[1] - other[1])) < 1e-7
    assert isinstance(choose_arrays(SCALAR), NumPyArrays)
