"""Plans of datasets: which objects exist, how they are pressed, with which sensors they are seen.

A plan is a TOML file, or what it changes of another, its `base`. Its fields of the scene have values or distributions
(`gelsim.scene.distributions`). Four things are drawn, each from a generator of its own, SeedSequence(seed, spawn_key=(kind, number)):
sensors (what a light field has to be measured for), objects (made once, pressed many times), presses (mechanics runs: hardness scale,
contact, motion) and episodes (an end point of a press, its timing, and what light costs nothing: markers, exposure, powers). So number i of
a seed is the same for any number of workers and in any order.

Hardness to modulus: E(H) = s E_Hertz(H) (E_Hertz(H) / E_Hertz(H₀))^(γ - 1), s and γ drawn by press, the same for gel and object, H₀ the
gel's hardness: the literature disagrees by two over s and leaves γ open (docs/physics.md).

Left out: dependence between fields, other than through kinds of objects.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from gelsim.data.episodes import read_json
from gelsim.errors import DatasetError, GelsimError, SceneError, within
from gelsim.scene import materials
from gelsim.scene.definition import Scene
from gelsim.scene.distributions import DRAWS, check_distribution, check_fields, draw, draw_fields, is_number
from gelsim.scene.fields import convert, nearest
from gelsim.scene.layers import Layer, build_scene, from_folder, read_toml
from gelsim.shape.mesh_file import check_file

SENSOR, OBJECT, PRESS, EPISODE, SPLIT = range(5)
"""First numbers of the spawn keys."""
RIGID_DEEPEST = 0.6
"""Of the gel's thickness: deeper presses of rigid objects end there, before the gel is cut through."""
HUMAN_OR_ROBOT = ("human", "robot")
SPLITS_LEARNT = ("train", "validation")
"""Splits that a training sees; the others are test rows."""
SPLITS = (*SPLITS_LEARNT, "novel_hardness", "novel_shape", "robot", "vessels", "complicated", "natural")


def generator(seed: int, kind: int, *numbers: int) -> np.random.Generator:
    """The generator of one of the things that are drawn."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(kind, *numbers)))


# ---- plans ----


@dataclass(frozen=True)
class Kind:
    """A kind of object: how many there are, and what they are like."""

    name: str
    count: int
    fields: Mapping[str, Any]
    split: str | None = None
    """Row of the evaluation that its objects belong to, instead of the group's."""
    press: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Of presses of its objects, whoever presses them; beats the plan's and the group's."""


@dataclass(frozen=True)
class Group:
    """Objects and a way to press them."""

    number: int
    name: str
    share: float
    """Of the presses."""
    motion: str
    split: str
    kinds: tuple[Kind, ...]
    fields: Mapping[str, Any]
    """Of the press; beats the plan's."""
    objects_of: int | None = None
    """Presses the objects of another group instead, of those that are trained on."""
    train_share: float = 1.0
    """Of its objects: these are trained on where `split` is another row."""


@dataclass(frozen=True)
class Plan:
    """A plan that was read and checked."""

    name: str
    resolution: tuple[int, int]
    end_points: tuple[float, ...]
    """Episodes of one press: each ends at a share of its approach, drawn between this and the next; ascending, 1 the whole."""
    frames: Any
    lead: Any
    """Frames before first touch."""
    hold: Any
    """Frames after the end."""
    unevenness: Any
    """Of a press by hand: relative standard deviation of its speed."""
    sensors: int
    sensor_fields: Mapping[str, Any]
    press_fields: Mapping[str, Any]
    episode_fields: Mapping[str, Any]
    modulus_scale: Any
    shore_slope: Any
    held_hardness: tuple[float, ...]
    validation_share: float
    groups: tuple[Group, ...]
    mode: str = "baked"
    spp: int = 12
    digest: str = ""
    """SHA-256 of all that stands in it."""
    table: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """All that stands in it: what a dataset keeps of it, in meta/plan.json."""


_PLAN = {
    "name", "resolution", "mode", "spp", "end_points", "frames", "lead", "hold", "unevenness", "sensors", "press", "episode", "relation",
    "splits", "groups",
}  # fmt: skip
_GROUP = {"number", "name", "share", "motion", "split", "objects_of", "train_share", "press", "kinds"}
_KIND = {"name", "count", "object", "split", "press"}
OF_A_PRESS = ("gel", "object", "contact", "press")
"""What a group, or a kind of object, may say of its presses."""
AFTER_BAKE = ("markers", "camera", "lights", "seed")
"""What an episode may draw: a light field need not be measured again for it (`gelsim.generate` checks which fields of these)."""


def plan_path(name: str) -> Path:
    """A plan's file: a path that ends in .toml (or the .json that a dataset keeps), or one of the plans that come along."""
    if name.endswith((".toml", ".json")):
        return Path(name)
    inside = Path(__file__).parents[1] / "_plans"
    folder = inside if inside.is_dir() else Path(__file__).parents[2] / "scenes" / "plans"
    known = sorted(path.stem for path in folder.glob("*.toml"))
    if name not in known:
        raise SceneError(f"--plan {name!r}: known are {', '.join(known)}, or a path ending in .toml{nearest(name, known)}")
    return folder / f"{name}.toml"


def load_plan(name: str) -> Plan:
    """Reads and checks a plan.

    Raises:
        SceneError: It cannot be read, or something in it is unknown, impossible, or out of what a scene allows.
    """
    path = plan_path(name)
    table = _kept(path) if path.suffix == ".json" else read_toml(path, "--plan")
    try:
        if path.suffix == ".json":
            return _plan(_upon_base(table))
        plan = _plan(_upon_base(_anchored(table, path.resolve().parent)))
        _check_files(plan)
        return plan
    except SceneError as error:
        raise SceneError(f"plan {path.name}: {error}") from None


def _upon_base(table: Layer, above: tuple[str, ...] = ()) -> Layer:
    """A plan's table upon that of its base, which may have one too (`above`: the bases on the way here).

    One level deep: a table's keys beat those of the same table, everything else is replaced.
    """
    if "base" not in table:
        return table
    name = str(table["base"])
    if name in above:
        raise SceneError(f"base = {name!r}: a plan cannot start from itself ({' -> '.join((*above, name))})")
    path = plan_path(name)
    below = _upon_base(_anchored(read_toml(path, "--plan"), path.resolve().parent), (*above, name))
    own = {key: value for key, value in table.items() if key != "base"}
    both = {key: below[key] | own[key] for key in own if isinstance(own[key], dict) and isinstance(below.get(key), dict)}
    return below | own | {key: value for key, value in both.items() if not any(kind in own[key] for kind in DRAWS)}


def _anchored(table: Any, folder: Path, name: str = "") -> Any:
    """A plan's table with the paths in it, of objects, sensors and its base, taken from the folder of its file; `name`: where it stands."""
    if isinstance(table, list):
        return [_anchored(item, folder, name) for item in table]
    if isinstance(table, dict):
        inner = {key: name if key in DRAWS or key in ("then", "else") else key for key in table}
        return {key: _anchored(value, folder, inner[key]) for key, value in table.items()}
    if name == "base" and str(table).endswith(".toml"):
        return os.path.normpath(folder / table)
    return from_folder({"mesh": "object.mesh", "preset": "sensor.preset"}.get(name, name), table, folder)


def _check_files(plan: Plan) -> None:
    """Every mesh file that an object may have, read."""
    for group in plan.groups:
        for kind in group.kinds:
            fields = {name.removeprefix("object."): value for name, value in kind.fields.items()}
            drawn = fields.get("mesh")
            paths = drawn.get("choice", drawn.get("cycle", [])) if isinstance(drawn, dict) else [drawn] if drawn else []
            for path in paths:
                with within(f"groups {group.name!r}, kind {kind.name!r}"):
                    check_file(fields | {"mesh": path})


def _kept(path: Path) -> Layer:
    """The table of a plan that a dataset keeps."""
    try:
        return read_json(path)
    except DatasetError as error:
        raise SceneError(f"--plan {error}") from None


def _plan(table: Layer) -> Plan:
    _known(table, _PLAN, "")
    missing = sorted(_PLAN - {"mode", "spp", "relation", "splits", "lead", "hold", "unevenness"} - set(table))
    if missing:
        raise SceneError(f"{missing[0]} is missing")
    sensors = dict(table["sensors"])
    count = _whole(sensors.pop("count", 1), "sensors.count", 1, 1000)
    check_fields(sensors, "sensors", ("sensor", "gel", "lights", "coating", "camera", "markers"))
    check_fields(table["press"], "press", ("gel", "object", "contact", "press", "fidelity"))
    check_fields(table["episode"], "episode", AFTER_BAKE)
    relation, splits = table.get("relation", {}), table.get("splits", {})
    _known(relation, {"modulus_scale", "shore_slope"}, "relation")
    _known(splits, {"held_hardness", "validation_share"}, "splits")
    drawn = {name: table.get(name, 0) for name in ("frames", "lead", "hold", "unevenness")}
    drawn |= {name: relation.get(name, 1.0) for name in ("modulus_scale", "shore_slope")}
    for name, value in drawn.items():
        check_distribution(value, name)
    ends = table["end_points"]
    if not isinstance(ends, list) or not ends or not all(is_number(e) and 0 < e <= 1 for e in ends) or ends != sorted(set(ends)):
        raise SceneError(f"end_points = {ends!r}: expected ascending shares of the press, 0 to 1")
    groups = tuple(_group(item, f"groups[{i}]") for i, item in enumerate(table["groups"]))
    numbers = {group.number for group in groups if group.kinds}
    for group in groups:
        if (group.objects_of is None) == (not group.kinds) or (group.objects_of is not None and group.objects_of not in numbers):
            raise SceneError(f"groups: {group.name!r} needs kinds of its own, or objects_of = a group that has some")
    if not groups or sum(group.share for group in groups) <= 0:
        raise SceneError("groups: their shares are all 0")
    return Plan(
        str(table["name"]),
        convert(table["resolution"], tuple[int, int], "resolution"),
        tuple(ends),
        sensors=count,
        sensor_fields=sensors,
        press_fields=table["press"],
        episode_fields=table["episode"],
        held_hardness=tuple(splits.get("held_hardness", ())),
        validation_share=_share(splits.get("validation_share", 0.1), "splits.validation_share"),
        groups=groups,
        digest=hashlib.sha256(json.dumps(table, sort_keys=True).encode()).hexdigest(),
        table=table,
        mode=str(table.get("mode", "baked")),
        spp=_whole(table.get("spp", 12), "spp", 1, 65536),
        **drawn,
    )


def _group(table: Layer, where: str) -> Group:
    _known(table, _GROUP, where)
    for name in ("number", "name", "share", "motion", "split"):
        if name not in table:
            raise SceneError(f"{where}: {name} is missing")
    for name, allowed in (("motion", HUMAN_OR_ROBOT), ("split", SPLITS)):
        if table[name] not in allowed:
            raise SceneError(f"{where}: {name} = {table[name]!r}: allowed are {', '.join(allowed)}{nearest(str(table[name]), allowed)}")
    check_fields(table.get("press", {}), f"{where}.press", OF_A_PRESS)
    kinds = []
    for i, item in enumerate(table.get("kinds", [])):
        place = f"{where}.kinds[{i}]"
        _known(item, _KIND, place)
        fields = _by_full_name(item.get("object", {}), "object")
        check_fields(fields, f"{place}.object")
        if item.get("split") not in (None, *SPLITS):
            raise SceneError(f"{place}: split = {item['split']!r}: allowed are {', '.join(SPLITS)}")
        check_fields(item.get("press", {}), f"{place}.press", OF_A_PRESS)
        count = _whole(item.get("count", 1), f"{place}.count", 1, 100000)
        kinds.append(Kind(str(item.get("name", i)), count, fields, item.get("split"), item.get("press", {})))
    share = table["share"]
    if not is_number(share) or share < 0:
        raise SceneError(f"{where}: share = {share!r}: expected a number of 0 or more")
    return Group(
        _whole(table["number"], f"{where}.number", 1, 5), str(table["name"]), float(share), table["motion"], table["split"], tuple(kinds),
        table.get("press", {}), table.get("objects_of"), _share(table.get("train_share", 1.0), f"{where}.train_share"),
    )  # fmt: skip


def _by_full_name(table: Layer, prefix: str) -> Layer:
    """Tables of fields as one, by dotted names; a distribution is a table too, but not of fields."""
    flat: Layer = {}
    for key, value in table.items():
        name = f"{prefix}.{key}"
        inner = isinstance(value, dict) and key in ("skin", "grains", "law_constants")
        flat |= _by_full_name(value, name) if inner else {name: value}
    return flat


def _known(table: object, names: set[str], where: str) -> None:
    if not isinstance(table, dict):
        raise SceneError(f"{where}: expected a table")
    for key in table:
        if key not in names:
            raise SceneError(f"unknown key {f'{where}.{key}' if where else key!r}{nearest(key, names)}")


def _whole(value: object, where: str, low: int, high: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise SceneError(f"{where} = {value!r}: expected a whole number, {low} … {high}")
    return value


def _share(value: Any, where: str) -> float:
    if not is_number(value) or not 0 <= value <= 1:
        raise SceneError(f"{where} = {value!r}: allowed is 0 … 1")
    return float(value)


# ---- what is drawn ----


@dataclass(frozen=True)
class DrawnObject:
    """An object of a plan's catalogue."""

    name: str
    group: Group
    kind: Kind
    number: int
    """Within its group."""
    layer: Layer
    trained: bool
    """Presses of it by hand are trained on."""
    split: str
    """Of its presses by hand."""


@dataclass(frozen=True)
class Press:
    """One mechanics run."""

    number: int
    group: Group
    object: DrawnObject
    sensor: int
    scene: Scene
    """How it is pressed at most; press.depth_mm and force_n bound it."""
    split: str | None
    """None: not part of any row."""


@dataclass(frozen=True)
class EpisodeDraw:
    """What an episode takes of its press, and how it is seen."""

    index: int
    end: float
    """Share of the press's approach at which it ends."""
    frames: int
    lead: int
    hold: int
    unevenness: float
    rng: np.random.Generator
    """For the trajectory."""
    layer: Layer
    """Of the scene, beside the press's own."""


class Catalogue:
    """A plan with a seed: everything that can be drawn from it, by number."""

    def __init__(self, plan: Plan, seed: int) -> None:
        if seed < 0:
            raise SceneError(f"--seed {seed}: allowed is 0 or more")
        self.plan, self.seed = plan, seed
        shares = np.array([group.share for group in plan.groups])
        self._shares = shares / shares.sum()
        self._object = lru_cache(maxsize=None)(self._drawn_object)
        self._sensor = lru_cache(maxsize=None)(self._drawn_sensor)

    def objects(self, group: Group) -> int:
        """How many objects a group has of its own."""
        return sum(kind.count for kind in group.kinds)

    def object(self, group: Group, number: int) -> DrawnObject:
        """Object `number` of a group."""
        return self._object(next(i for i, item in enumerate(self.plan.groups) if item is group), number)

    def press(self, number: int) -> Press:
        """Press `number`.

        Raises:
            SceneError: The plan drew a scene that contradicts itself.
        """
        plan, rng = self.plan, generator(self.seed, PRESS, number)
        group, owner, thing = self._chosen(rng)
        sensor = int(rng.integers(plan.sensors))
        base = self._sensor(sensor)
        layers = [self._sensor_layer(sensor), {"object": thing.layer}]
        fields = {**plan.press_fields, **group.fields, **thing.kind.press}
        try:
            layers.append(draw_fields(fields, rng, number, base))
            depth = layers[-1].get("press", {}).get("depth_mm")
            if thing.layer.get("rigid") and is_number(depth):
                layers[-1]["press"]["depth_mm"] = min(depth, RIGID_DEEPEST * base.gel.thickness_mm)
            scale, slope = draw(plan.modulus_scale, rng, number), draw(plan.shore_slope, rng, number)
            scene = _hardened(build_scene(*layers), scale, slope)
            if scene.press.depth_mm is None:
                raise SceneError("press.depth_mm = none: presses of a plan go to a depth, with press.force_n to stop them; no path")
        except GelsimError as error:
            raise SceneError(f"plan {plan.name}, seed {self.seed}, press {number} ({group.name}): {error}") from None
        return Press(number, group, thing, sensor, scene, self._split(group, owner, thing))

    def split(self, number: int) -> str | None:
        """Of press `number`, whose scene is not built for it."""
        return self._split(*self._chosen(generator(self.seed, PRESS, number)))

    def _chosen(self, rng: np.random.Generator) -> tuple[Group, Group, DrawnObject]:
        """The first that is drawn of a press: its group, the one whose objects that has, the object."""
        plan = self.plan
        group = plan.groups[int(rng.choice(len(plan.groups), p=self._shares))]
        owner = group if group.kinds else next(item for item in plan.groups if item.number == group.objects_of and item.kinds)
        count = self.objects(owner)
        chosen = int(rng.integers(count))
        if group is not owner:
            # The next one that is trained on: a row of its own may not show what no training saw.
            chosen = next((k for k in ((chosen + j) % count for j in range(count)) if self.object(owner, k).trained), chosen)
        return group, owner, self.object(owner, chosen)

    def episode(self, press: Press, end: int) -> EpisodeDraw:
        """Episode `end` (of len(plan.end_points)) of a press."""
        plan = self.plan
        index = press.number * len(plan.end_points) + end
        rng = generator(self.seed, EPISODE, index)
        low = plan.end_points[end]
        high = plan.end_points[end + 1] if end + 1 < len(plan.end_points) else low
        share = float(rng.uniform(low, high)) if end + 1 < len(plan.end_points) else low
        frames, lead, hold = (max(int(draw(value, rng, index)), 0) for value in (plan.frames, plan.lead, plan.hold))
        uneven = float(draw(plan.unevenness, rng, index)) if press.group.motion == "human" else 0.0
        layer = draw_fields(plan.episode_fields, rng, index, press.scene)
        return EpisodeDraw(index, share, max(frames, lead + hold + 2), lead, hold, uneven, rng, layer)

    def _split(self, group: Group, owner: Group, thing: DrawnObject) -> str | None:
        if group is owner:
            return thing.split
        if not thing.trained:
            return None
        return thing.split if group.split == "train" else group.split

    def _drawn_sensor(self, number: int) -> Scene:
        rng = generator(self.seed, SENSOR, number)
        fields = self.plan.sensor_fields
        preset = draw(fields.get("sensor.preset", "fingertip2017"), rng, number)
        base = build_scene({"sensor": {"preset": preset}})
        layer = draw_fields({name: value for name, value in fields.items() if name != "sensor.preset"}, rng, number, base)
        return build_scene({"sensor": {"preset": preset}}, layer)

    def sensor_scene(self, number: int) -> Scene:
        """A scene with a sensor of the pool and the plan's pictures: what a light field is measured with."""
        return build_scene(self._sensor_layer(number))

    def _sensor_layer(self, number: int) -> Layer:
        sensor = self._sensor(number)
        table: Layer = {"sensor": {"preset": sensor.sensor.preset}}
        for name in ("gel", "camera", "lights", "coating", "markers"):
            table[name] = _plain(dataclasses.asdict(getattr(sensor, name)))
        table["render"] = {"mode": self.plan.mode, "spp": self.plan.spp, "resolution": list(self.plan.resolution)}
        return table

    def _drawn_object(self, which: int, number: int) -> DrawnObject:
        plan, group = self.plan, self.plan.groups[which]
        rest = number
        for kind in group.kinds:
            if rest < kind.count:
                break
            rest -= kind.count
        rng = generator(self.seed, OBJECT, group.number, number)
        layer = draw_fields(kind.fields, rng, number)["object"]
        own = generator(self.seed, SPLIT, group.number, number)
        held = layer.get("shore_00") in plan.held_hardness
        first, second = own.random(2)
        split = kind.split or group.split
        if kind.split is None and group.split == "train" and held:
            split = "novel_hardness"
        elif kind.split is None and group.split != "train" and group.train_share < 1.0 and first < group.train_share and not held:
            split = "train"
        trained = split == "train"
        if trained and second < plan.validation_share:
            split = "validation"
        return DrawnObject(f"g{group.number}-{number:04d}-{layer['shape']}", group, kind, number, layer, trained, split)


def _plain(table: Layer) -> Layer:
    """Without what is None: TOML and layers have no such thing."""
    plain: Layer = {}
    for key, value in table.items():
        if value is None:
            continue
        if isinstance(value, (list, tuple)) and value and isinstance(value[0], dict):
            value = [{k: v for k, v in item.items() if v is not None} for item in value]
        plain[key] = list(value) if isinstance(value, tuple) else value
    return plain


def _hardened(scene: Scene, scale: float, slope: float) -> Scene:
    """With the relation of hardness to modulus that was drawn, for gel and object alike."""
    reference = scene.gel.shore_00
    replaced = {}
    for name in ("gel", "object"):
        section: Any = getattr(scene, name)
        factor = scale
        if section.shore_00 is not None and reference is not None:
            ratio = materials.modulus_from_shore_00(section.shore_00) / materials.modulus_from_shore_00(reference)
            factor *= ratio ** (slope - 1.0)
        if section.shore_00 is not None or section.shore_a is not None:
            section = dataclasses.replace(section, modulus_scale=section.modulus_scale * factor)
        if name == "object":
            for part in ("skin", "grains"):
                inner = getattr(section, part)
                if inner.shore_00 is not None or inner.shore_a is not None:
                    section = dataclasses.replace(section, **{part: dataclasses.replace(inner, modulus_scale=inner.modulus_scale * scale)})
        replaced[name] = section
    return scene.replace(**replaced)
