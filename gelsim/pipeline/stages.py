"""The line from a scene to its press and its pictures: each stage in turn, timed, with what it chose written down.

    scene -> shapes, meshing -> fem -> membrane -> optics -> files

`press` and `render` compute and return arrays; `run` does what the commands do: the same, and a result folder. What is solved is written
as soon as it is whole, so a render that fails still leaves its press.
"""

from __future__ import annotations

import dataclasses
import importlib.metadata
import math
import platform
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from gelsim.errors import MeshingError, PressEnd, SceneError, SolveError, SolveStatus
from gelsim.files import digest
from gelsim.geometry import QuadraticSurface, TetMesh
from gelsim.pipeline import outputs
from gelsim.results import Deformation, Frame, Membrane, PressSensitivity
from gelsim.scene import materials
from gelsim.scene.definition import Press, Scene, unread_sizes
from gelsim.scene.layers import load_scene, scene_table
from gelsim.scene.motion import motion
from gelsim.units import MM

if TYPE_CHECKING:
    from gelsim.mesh.reductions import Reduction

Progress = Callable[[str, int, int], None]
"""Called with (stage, done, total)."""

VERSIONS_OF = ("gelsim", "numpy", "scipy", "mitsuba", "drjit", "warp-lang", "pytetwild", "mkl", "trimesh")
"""Packages that decide a result."""

DRAWS = 2
"""Meshes that a press may have: fTetWild draws them by lot, and a body that buckles or is crushed may find no way on one and find one on
another (docs/validation.md, *Random scenes*)."""

MOST_OVERLAP_UM = 50.0
"""Overlap of the bodies that is warned of, and that the stability suite allows: at `fast` a tenth of the finest edge is 25 µm, and a sharp
rigid rim cuts in."""

LIVE = "live"
"""The fidelity that solves no finite elements (`gelsim.live.press`)."""

CREASED = 0.1
"""Of its length, to which a rim squeezes the gel's face: of such presses half are lost (`docs/studies/creases.py`)."""
UNSURE = 0.1
"""Estimated relative error of the force above which a report warns."""

MECHANICS = ("sensor", "gel", "object", "contact", "press", "fidelity", "target_error", "target_membrane_um")
"""Parts of a scene that decide its press; `resume` needs them unchanged."""


@dataclass
class Record:
    """What report.json says about how a result came to be; the stages fill it."""

    seconds: dict[str, float] = field(default_factory=dict)
    """Wall seconds by stage."""
    meshes: dict[str, Any] = field(default_factory=dict)
    choices: dict[str, Any] = field(default_factory=dict)
    """What was decided on the user's behalf, and why."""
    warnings: list[str] = field(default_factory=list)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Times a stage, and keeps the warnings raised in it."""
        start = time.perf_counter()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("default")
            try:
                yield
            finally:
                self.seconds[name] = round(self.seconds.get(name, 0.0) + time.perf_counter() - start, 3)
        self.warnings += [f"{name}: {item.message}" for item in caught if not issubclass(item.category, DeprecationWarning)]

    def note(self, text: str) -> None:
        """Warns of something once."""
        if text not in self.warnings:
            self.warnings.append(text)

    def add(self, other: Record) -> None:
        """Takes what another one says beside its own."""
        self.seconds |= other.seconds
        self.meshes |= other.meshes
        self.choices |= other.choices
        self.warnings += other.warnings


def press(
    scene: Scene,
    *,
    device: str = "auto",
    progress: Progress | None = None,
    record: Record | None = None,
    throw: bool = True,
    enough: Callable[[Deformation], bool] | None = None,
) -> Deformation:
    """Meshes both bodies and solves the press.

    Args:
        device: "auto", "cpu" or "cuda".
        enough: Of a press that finds no equilibrium further on, whether it has got so far that it need not begin again at rest, with its
            mesh or, a soft object's, with another (`DRAWS`). None: it begins again.
        record: Filled with seconds, mesh sizes and choices.
        throw: Raise when not every state was solved; else the deformation's `status` says so.
    Raises:
        SceneError: Shape or mesh file cannot be built; MeshingError: it cannot be filled.
        SolveError: Newton failed; carries the states solved before.
    """
    record = record or Record()
    if scene.target_error is not None or scene.target_membrane_um is not None:
        return _press_to_target(scene, device, progress, record, throw, enough)
    report = (lambda done, total: progress("press", done, total)) if progress else None
    if scene.fidelity == LIVE:
        with record.stage("import"):
            from gelsim.live.press import live_press
        with record.stage("press"):
            return live_press(scene, progress=report)
    with record.stage("import"):
        import gelsim.fem  # noqa: F401  # counted here, not as the press
        from gelsim.mesh.reductions import choose_reduction, solids
        from gelsim.shape.outlines import edge_radius
    reduction = choose_reduction(scene)
    _note_reduction(reduction, record)
    gel_material, object_materials = materials.gel_material(scene), materials.object_materials(scene)
    object_material = object_materials.get("body")
    record.choices["gel_modulus_kpa"] = gel_material.youngs_modulus / 1e3
    record.choices["object_modulus_kpa"] = object_material.youngs_modulus / 1e3 if object_material else None
    for name, material in list(object_materials.items())[1:]:
        record.choices[f"{name}_modulus_kpa"] = material.youngs_modulus / 1e3
    if scene.object.rigid or scene.object.edge_radius_mm:
        record.choices["edge_radius_mm"] = edge_radius(scene.object, scene.fidelity) / MM
    if reduction.planar:
        free = scene.press.symmetry == "auto"
        found = _press_profile(scene, reduction, record, report, throw and not free)
        if not (free and found.lost):
            return found
        reduction = solids(scene, f"a profile ended at {found.approach[-1] * 1e3:.3g} mm, and has no other tries")
        _note_reduction(reduction, record)
    return _press_solid(scene, reduction.planes, device, record, report, throw, enough)


def _note_reduction(reduction: Reduction, record: Record) -> None:
    record.choices["symmetry"] = reduction.kind if reduction.planar else sorted(reduction.planes)
    record.choices["symmetry_reason"] = reduction.reason
    record.choices["symmetry_force_error"] = reduction.error


def _press_solid(
    scene: Scene,
    symmetry: frozenset[str],
    device: str,
    record: Record,
    progress: Callable[[int, int], None] | None,
    throw: bool,
    enough: Callable[[Deformation], bool] | None,
) -> Deformation:
    """The press as a solid; of the object's meshes the one with which it got furthest."""
    from gelsim.fem import solve_press
    from gelsim.fem.strategy import further

    best, meshes = None, {}
    for draw in range(1 if scene.object.rigid else DRAWS):
        try:
            gel, body, placement = _bodies(scene, symmetry, record, draw)
        except (MeshingError, SceneError) as error:
            if best is None:
                raise
            best = best.warned(f"did not reach its end with the object's first mesh, and could not be given another: {error}")
            break
        with record.stage("press"):
            found = solve_press(scene, gel, body, placement, device=device, progress=progress, enough=enough)
        if draw:
            found = found.warned(f"did not reach its end with the object's first mesh: solved with one drawn anew, number {draw + 1}")
        best = further(best, found)
        if best is found:
            meshes = dict(record.meshes)
        if not found.lost or (enough is not None and enough(best)):
            break
    assert best is not None
    record.meshes |= meshes
    if throw and best.status is not SolveStatus.CONVERGED:
        raise SolveError(best.message, best)
    return best


def _press_profile(
    scene: Scene, reduction: Reduction, record: Record, progress: Callable[[int, int], None] | None, throw: bool
) -> Deformation:
    """The press as a profile."""
    from gelsim.fem import solve_planar
    from gelsim.mesh import profiles

    with record.stage("mesh"):
        gel, body = profiles.mesh_profiles(scene)
        record.meshes |= {"gel": profiles.mesh_report(gel), "object": profiles.mesh_report(body)}
    with record.stage("press"):
        press = solve_planar(
            scene,
            gel,
            body,
            depth_mm=None if reduction.kind == "axisymmetric" else scene.gel.size_mm[1],
            progress=progress,
            throw=throw,
        )
    estimate = press.report.error_estimate
    assert estimate is not None
    return press.reporting(error_estimate=replace(estimate, force=estimate.force + reduction.error))


def _press_to_target(
    scene: Scene,
    device: str,
    progress: Progress | None,
    record: Record,
    throw: bool,
    enough: Callable[[Deformation], bool] | None,
) -> Deformation:
    """`press` at the cheapest fidelity whose error estimate meets the scene's target; record.choices says which and why."""
    from gelsim.live.press import live_error
    from gelsim.mesh.reductions import choose_reduction
    from gelsim.pipeline import fidelity

    def solve(name: str) -> Deformation:
        return press(_at(scene, name), device=device, progress=progress, record=record, throw=throw, enough=enough)

    assert not isinstance(scene.target_error, str)
    target = fidelity.Target(scene.target_error, scene.target_membrane_um)
    kind = "profile" if choose_reduction(_at(scene, "balanced")).planar else "solid"
    known = live_error(scene) if kind == "solid" else None  # a profile is solved as soon
    if known is not None and target.allows(*known):
        why = f"target {target}: {100 * known[0]:.2g} % of force, {known[1]:.2g} µm of membrane, as measured on such presses"
        record.choices["fidelity"] = {"chosen": LIVE, "why": why, "tried": []}
        return solve(LIVE)
    chosen = fidelity.press_to_target(target, solve, kind)
    record.choices["fidelity"] = {"chosen": chosen.fidelity, "why": chosen.why, "tried": chosen.tried}
    if not chosen.met:
        record.warnings.append(f"the target was not met at fidelity {chosen.fidelity}: {chosen.why}")
    return chosen.press


def _at(scene: Scene, name: str) -> Scene:
    """The scene at a fidelity, whatever its target."""
    return scene.replace(fidelity=name, target_error=None, target_membrane_um=None)


def _bodies(
    scene: Scene, symmetry: frozenset[str], record: Record, draw: int = 0
) -> tuple[TetMesh, TetMesh | QuadraticSurface, tuple[Any, Any]]:
    """Meshes of gel and object (the draw-th one of it), of a rigid one its surface, and the object's placement at first touch."""
    with record.stage("import"):
        from gelsim.fem import rigid_placement
        from gelsim.mesh import body_mesh, gel_mesh
        from gelsim.shape import shapes
        from gelsim.shape.mesh_file import HELD_BELOW
        from gelsim.shape.orientation import is_reoriented
    with record.stage("mesh"):
        if shapes.of_file(scene.object):
            _look_at_file(scene, record)
        # The object first: a file that cannot be used should not cost the gel's mesh.
        if scene.object.rigid:
            body = surface = shapes.rigid_surface(scene, symmetry)
            record.meshes["object"] = {"nodes": len(body.nodes), "elements": 0, "surface_faces": len(body.faces)}
            if shapes.of_file(scene.object) and len(body.faces) < (of_file := record.meshes["file"]["faces"]):
                record.meshes["file"]["faces_near_gel"] = len(body.faces)
                record.note(f"object.mesh: cut down to the {len(body.faces)} of its {of_file} faces that lie near the gel")
        else:
            body = body_mesh.mesh_object(scene, symmetry, drawn_before=draw)
            surface = body.surface("contact")
            record.meshes["object"] = body_mesh.mesh_report(body, materials.parts(scene.object))
            if is_reoriented(scene.object):
                record.meshes["object"]["held_at_share_of_height"] = 1.0 - HELD_BELOW
        gel = gel_mesh.mesh_gel(scene, symmetry)
        record.meshes["gel"] = body_mesh.mesh_report(gel)
        if scene.object.rigid:
            placement = rigid_placement(scene)
        else:
            placement = shapes.placement(scene, surface)
        return gel, body, placement


def bodies(scene: Scene) -> tuple[TetMesh, TetMesh | QuadraticSurface, tuple[Any, Any]]:
    """Meshes of gel and object, of a rigid one its surface, and the object's placement (rotation, translation [m]) at first touch."""
    from gelsim.shape import shapes

    if scene.target_error is not None or scene.target_membrane_um is not None:
        raise SceneError("target_error, target_membrane_um: they choose the fidelity of a single press; here give fidelity instead")
    if scene.fidelity == LIVE:
        raise SceneError(f'fidelity = "{LIVE}" has no finite elements; here give fast, balanced or reference')
    return _bodies(scene, shapes.press_symmetry(scene), Record())


def press_sensitivity(scene: Scene, points_mm: Sequence[tuple[float, float]] = ()) -> PressSensitivity:
    """Presses, and says how force and surface answer to small changes of the moduli and of the approach, at every recorded state.

    Each derivative is that of a converged state, by its linearised equations (`gelsim.fem.sensitivity`): one factorisation a state, and
    under twenty back-substitutions for the object's modulus and for the approach, however many points.

    Args:
        scene: Without friction (contact.friction_coefficient = 0) and viscosity.
        points_mm: Rest points (x, y) of the gel's outer surface whose normal displacement is differentiated.
    Raises:
        SceneError: The scene has friction or viscosity, or a point is not on the gel. MeshingError, SolveError: as of `press`.
    """
    from gelsim.fem import differentiate_press

    points = np.array(points_mm, float).reshape(-1, 2) * MM
    outputs.check_probe_points(points, scene, "points_mm")
    gel, body, placement = bodies(scene)
    for axis in gel.symmetry:  # a mirrored point moves up and down as its image does
        points[:, "xy".index(axis)] = np.abs(points[:, "xy".index(axis)])
    surface = gel.surface("coated")
    nodes, shares = outputs.surface_shares(surface.nodes, surface.faces, points)
    return differentiate_press(scene, gel, body, placement, nodes=np.unique(gel.groups["coated"])[nodes], shares=shares)


def press_batch(scenes: Sequence[Scene], *, device: str = "auto", size: int = 64, progress: Progress | None = None) -> list[Deformation]:
    """Solves many presses: those that reduce to a profile or relax one by one, the others side by side where they have the same meshes.

    A press that fails says so in its `status`.

    Args:
        device: "auto" takes a CUDA device where there is one; on the CPU a batch is no faster than its presses one by one.
        size: Most presses of a batch.
    Raises:
        SceneError, MeshingError: as `press`, before anything is solved.
    """
    from gelsim.fem import batch_device, solve_batch
    from gelsim.mesh.reductions import choose_reduction

    groups: dict[bytes, list[int]] = {}
    prepared, known = {}, {}
    presses: dict[int, Deformation] = {}
    for number, scene in enumerate(scenes):
        remembers = scene.gel.prony_g or (scene.object.prony_g and not scene.object.rigid)
        if scene.fidelity == LIVE or choose_reduction(scene).planar or remembers:
            presses[number] = press(scene, throw=False)
            continue
        shape = _geometry(scene)
        if shape not in known:
            known[shape] = bodies(scene)
        gel, body, placement = known[shape]
        prepared[number] = (scene, gel, body, placement)
        cells = gel.tets, body.tets if isinstance(body, TetMesh) else body.faces
        groups.setdefault(b"".join(array.tobytes() for array in cells), []).append(number)
    for members in groups.values():
        for start in range(0, len(members), size):
            some = members[start : start + size]
            show = _counting(progress, len(presses), len(scenes))
            presses |= zip(some, solve_batch([prepared[i] for i in some], device=batch_device(device), progress=show), strict=True)
    return [presses[number] for number in range(len(scenes))]


def _geometry(scene: Scene) -> str:
    """All of a scene that decides its meshes: scenes that differ in materials alone share them."""
    same: dict[str, Any] = {"shore_00": None, "shore_a": None, "youngs_modulus_kpa": 1.0, "poissons_ratio": 0.49}
    return repr((replace(scene.gel, **same), replace(scene.object, **same), scene.press, scene.fidelity))


def _counting(progress: Progress | None, before: int, total: int) -> Callable[[int, int], None] | None:
    """Progress of a part, after `before` of `total`."""
    return (lambda done, _: progress("press", before + done, total)) if progress else None


def _look_at_file(scene: Scene, record: Record) -> None:
    """Records what was done to an object's file, and checks the depth as the scene does for other shapes: only the file has a height."""
    from gelsim.shape.mesh_file import read_part

    part = read_part(scene.object)
    record.meshes["file"] = part.done | {"faces": len(part.surface.faces)}
    for note in part.notes:
        record.note(note)
    height_mm = part.surface.vertices[:, 2].max() / MM
    way = motion(scene.press)
    name, depth_mm = ("press.depth_mm", scene.press.depth_mm) if way is None else ("press.path", way.deepest)
    if depth_mm is not None and depth_mm >= height_mm:
        raise SceneError(
            f"{name} = {depth_mm:g} mm: it must be less than the height of object.mesh = {scene.object.mesh!r}, {height_mm:.4g} mm"
        )


def membranes(scene: Scene, deformation: Deformation, *, record: Record | None = None) -> list[Membrane]:
    """The coated surface of each recorded state, ready to be drawn."""
    from gelsim.membrane import surface

    with (record or Record()).stage("membrane"):
        return surface.membrane_states(scene, deformation)


def render(
    scene: Scene, deformation: Deformation, *, device: str = "auto", progress: Progress | None = None, record: Record | None = None
) -> list[Frame]:
    """Draws every recorded state as the sensor's camera sees it.

    Raises:
        RenderError: The device asked for cannot render.
    """
    record = record or Record()
    surfaces = membranes(scene, deformation, record=record)
    scene, optics = _choose_renderer(scene, device, record)
    field = None
    if scene.render.mode == "baked":
        with record.stage("light field"):
            field = optics.light_field(scene, optics.choose_variant(device), progress)
        record.choices["light_field"] = field.errors
    with record.stage("render"):
        show = (lambda done, total: progress("render", done, total)) if progress else None
        return list(optics.render_frames(scene, surfaces, progress=show, device=device, light_field=field))


def simulate(scene: Scene, *, device: str = "auto", progress: Progress | None = None) -> tuple[Deformation, list[Frame]]:
    """Press and pictures in one call; raises what `press` and `render` raise."""
    deformation = press(scene, device=device, progress=progress)
    return deformation, render(scene, deformation, device=device, progress=progress)


@dataclass(frozen=True)
class Wanted:
    """What a result folder is to hold besides the mechanics."""

    pictures: bool = True
    radiance: bool = False
    """Of the pictures, also linear ones."""
    probe: Path | None = None
    """CSV of rest points x_mm, y_mm at which the gel's surface is sampled."""


def run(
    scene: Scene,
    out: Path,
    wanted: Wanted = Wanted(),
    *,
    force: bool = False,
    resume: bool = False,
    device: str = "auto",
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Computes a scene and writes its result folder; returns what report.json holds.

    Args:
        out: The folder; `force` replaces results in it, `resume` goes on where it stopped.
    Raises:
        SceneError: Bad input, or the folder cannot be used: nothing was written.
        SolveError: The press stopped early: what was solved, and the report, are in the folder.
    """
    points = None
    if wanted.probe is not None:
        points = outputs.read_probe_points(wanted.probe)
        outputs.check_probe_points(points, scene)
    folder = outputs.ResultFolder(out, force=force, resume=resume)
    start = time.perf_counter()
    record, solving = Record(), Record()
    if wanted.pictures:
        # What cannot be drawn should be known before minutes go into the press.
        scene, _ = _choose_renderer(scene, device, record)
    content = "".join(digest(Path(file)) for file in _files(scene))  # before minutes of solving
    earlier = _earlier_press(scene, content, folder.path, solving) if resume else None
    if earlier is None:
        try:
            deformation = press(scene, device=device, progress=progress, record=solving)
        except SolveError as error:
            if isinstance(error.deformation, Deformation):
                _write_mechanics(folder, scene, content, error.deformation, solving)
                _write_probe(folder, error.deformation, points)
                record.add(solving)
                report = _report(scene, device, record, error.deformation, start, out) | {"error": str(error)}
                folder.write("report.json", lambda path: outputs.write_report(path, report))
                raise SolveError(f"{error} (what was solved is in {out})", error.deformation) from None
            raise
        _write_mechanics(folder, scene, content, deformation, solving)
    else:
        deformation, before = earlier
        solving.choices["press"] = "taken from the folder (--resume)"
        if not wanted.pictures:  # pictures may lie there, of a scene with the same mechanics
            scene = before
    record.add(solving)
    frames = render(scene, deformation, device=device, progress=progress, record=record) if wanted.pictures else []
    if earlier is not None and before != scene:  # only now: a drawing that was stopped leaves the folder as it was
        folder.remove((*outputs.PICTURES, "report.json"))
        folder.write("scene.toml", lambda path: outputs.write_scene(path, scene))
    _write_probe(folder, deformation, points)
    if wanted.pictures:
        with record.stage("write"):
            _write_pictures(folder, scene, deformation, frames, wanted.radiance)
    report = _report(scene, device, record, deformation, start, out)
    if wanted.pictures:
        report["video"] = {
            "fps": outputs.video_fps(len(deformation.approach)),
            "slower_than_real_time_by": _slow_motion(deformation),
        }
    folder.write("report.json", lambda path: outputs.write_report(path, report))
    return report


def summary(report: dict[str, Any]) -> str:
    """A report in a few lines for people."""
    final = report["final"]
    seconds = ", ".join(f"{name} {value:.1f}" for name, value in report["seconds"].items() if name != "total" and value >= 0.05)
    most = f" (at most {final['largest_force_n']:.3f} N)" if final["largest_force_n"] > 1.01 * final["normal_force_n"] else ""
    aside = math.hypot(*final["force_n"][:2])
    shear = f", {aside:.3f} N along the gel" if aside > 0.01 * final["normal_force_n"] else ""
    lines = [
        f"{report['out']}: {final['frames']} states to {final['approach_mm']:.3f} mm, "
        f"{final['normal_force_n']:.3f} N{_doubt(report)}{shear} "
        f"on {final['contact_area_mm2']:.1f} mm²{most}{_why_ended(report)}",
        f"{report['seconds']['total']:.1f} s ({seconds})",
    ]
    return "\n".join([*lines, *(f"warning: {text}" for text in report["warnings"])])


def _doubt(report: dict[str, Any]) -> str:
    """The estimated error of the force, beside it."""
    estimate = (report["error_estimate"] or {}).get("force")
    return "" if estimate is None else f" ± {100 * estimate:.2g} %"


def _why_ended(report: dict[str, Any]) -> str:
    """Of a press that has two ends, which came first; nothing where nobody asked for the other."""
    press, first = report["scene"]["press"], report["choices"].get("ended_by")
    other = {PressEnd.DEPTH: "force_n", PressEnd.FORCE: "depth_mm"}.get(first)
    if other is None or press[other] in ("none", getattr(Press(), other)):
        return ""
    return f' ({first} = {press[first]:g} came before {other} = {press[other]:g}; "none" takes one away)'


def _choose_renderer(scene: Scene, device: str, record: Record) -> tuple[Scene, ModuleType]:
    """The scene with its mode settled, and gelsim.optics, once it is sure that it can draw this scene here."""
    with record.stage("variant"):
        from gelsim import optics
        from gelsim.optics.scene_dict import emitter_dict

        emitter_dict(scene)
        variant = optics.choose_variant(device)
        scene, why = optics.settle_mode(scene)
    if why:
        record.choices["mode"] = {"chosen": scene.render.mode, "why": why}
    record.choices["variant"] = variant.name
    record.choices["variant_reason"] = variant.reason
    record.warnings += optics.left_out(scene, variant)
    return scene, optics


def _files(scene: Scene) -> list[str]:
    """Those that decide the press beside the scene's own fields."""
    return [file for file in (scene.object.mesh, scene.gel.mesh, scene.press.path_csv) if file]


def _earlier_press(scene: Scene, content: str, out: Path, record: Record) -> tuple[Deformation, Scene] | None:
    """The press that lies in the folder and the scene that it was made for, if it is whole and of the same mechanics; fills `record`.

    `content`: the digests of the scene's mesh file and of its measured path.
    """
    if not (out / "press.npz").exists():
        return None
    if not (out / "scene.toml").exists():
        raise SceneError(f"--resume {out}: holds a press.npz but no scene.toml to compare with; give --force")
    earlier = load_scene(out / "scene.toml")
    for name in MECHANICS:
        if getattr(earlier, name) != getattr(scene, name):
            what = f"[{name}]" if dataclasses.is_dataclass(getattr(scene, name)) else name
            raise SceneError(f"--resume {out}: its press was made with another {what}; give --force to solve it anew, or another --out")
    deformation, account = outputs.read_press(out / "press.npz"), outputs.read_account(out / "press.npz")
    if deformation.status is not SolveStatus.CONVERGED:
        return None
    files = _files(scene)
    if files and account.get("mesh_sha256") != content:
        raise SceneError(
            f"--resume {out}: its press was made with another {' or '.join(files)}; give --force to solve it anew, or another --out"
        )
    record.add(Record(meshes=account.get("meshes", {}), choices=account.get("choices", {}), warnings=account.get("warnings", [])))
    return replace(deformation, report=outputs.solve_report(account)), earlier


def _write_mechanics(folder: outputs.ResultFolder, scene: Scene, content: str, deformation: Deformation, record: Record) -> None:
    """The press in place of earlier results, with what `_earlier_press` reads of it."""
    account = {
        "meshes": record.meshes, "choices": record.choices, "warnings": record.warnings, "info": deformation.report.table(),
        "mesh_sha256": content,
    }  # fmt: skip
    folder.remove()
    folder.write("scene.toml", lambda path: outputs.write_scene(path, scene))
    folder.write("press.npz", lambda path: outputs.write_press(path, scene, deformation, account))


def _write_probe(folder: outputs.ResultFolder, deformation: Deformation, points: Any) -> None:
    if points is not None:
        folder.write("probe.csv", lambda path: outputs.write_probe(path, deformation, points))


def _write_pictures(folder: outputs.ResultFolder, scene: Scene, deformation: Deformation, frames: list[Frame], radiance: bool) -> None:
    from gelsim.pipeline import sheet

    folder.write("frames", lambda path: outputs.write_frames(path, frames))
    if radiance:
        folder.write("radiance", lambda path: outputs.write_radiances(path, frames))
    folder.write("video.mp4", lambda path: outputs.write_video(path, frames))
    folder.write("height.npz", lambda path: outputs.write_heights(path, frames))
    folder.write("markers.csv", lambda path: outputs.write_markers(path, frames))
    folder.write("sheet.png", lambda path: sheet.draw_sheet(path, scene, deformation, frames))


def _report(scene: Scene, device: str, record: Record, deformation: Deformation, start: float, out: Path) -> dict[str, Any]:
    told, noted, estimate = deformation.report.table(), list(deformation.report.warnings), deformation.report.error_estimate
    solved = {name: value for name, value in told.items() if name not in ("warnings", "error_estimate")}
    if not deformation.converged.all():
        noted.append(f"{int((~deformation.converged).sum())} of {len(deformation.converged)} states did not converge")
    overlap = float(deformation.penetration.max()) * 1e3
    if overlap * 1e3 > MOST_OVERLAP_UM:
        finer = {"fast": "balanced", "balanced": "reference"}.get(scene.fidelity)
        noted.append(
            f"the bodies overlap by up to {overlap:.2g} mm, so that the membrane's pictures are off there"
            + (f": a sharp or crushed edge; --fidelity {finer} shows how much" if finer else "")
        )
    bare = deformation.report.coat_n_per_m is None and scene.object.rigid and scene.fidelity in ("balanced", "reference")
    if bare and (squeezed := deformation.gel.least_stretches(-1).min()) < CREASED:
        noted.append(
            f"the gel's face is squeezed to {squeezed:.1g} of its length: a bare one creases there, which takes long to solve or has no "
            "end; a coat resists (gel.coat_n_per_m = 5)"
        )
    if estimate is not None and estimate.force > UNSURE:
        noted.append(f"the force is known to {100 * estimate.force:.2g} % only (error_estimate); a finer --fidelity tells more")
    noted += unread_sizes(scene.object) + _beside_picture(scene, deformation)
    report = {
        "out": str(out),
        "status": deformation.status.value,
        "final": {
            "frames": len(deformation.approach),
            "approach_mm": deformation.approach[-1] * 1e3,
            "normal_force_n": 0.0 - deformation.force[-1, 2],
            "force_n": deformation.force[-1],
            "largest_force_n": -deformation.force[:, 2].min(),
            "contact_area_mm2": deformation.contact_area[-1] * 1e6,
            "min_jacobian": deformation.min_jacobian.min(),
            "penetration_mm": overlap,
        },
        "seconds": record.seconds | {"total": round(time.perf_counter() - start, 3)},
        "meshes": record.meshes,
        "choices": record.choices | solved,
        "error_estimate": told.get("error_estimate"),
        "error_estimate_note": None
        if estimate is not None
        else "not estimated by this version; --fidelity reference against balanced shows it",
        "device": {"asked": device, "machine": platform.machine(), "system": platform.platform(), "python": platform.python_version()},
        "versions": versions(),
        "seed": scene.seed,
        "scene": scene_table(scene),
        "warnings": record.warnings + noted,
    }
    plain = outputs.plain_json(report)
    assert isinstance(plain, dict)
    return plain


def _beside_picture(scene: Scene, deformation: Deformation) -> list[str]:
    """A warning where most of the contact pressure of the state that shows the press best lies outside the camera's field, its tilt left
    out."""
    pressure = np.maximum(deformation.contact_pressure[deformation.telling], 0.0)
    if not pressure.any():
        return []
    away = np.abs(deformation.gel.rest[:, :2] / MM - scene.camera.offset_mm)
    seen = (away <= np.array(scene.camera.field_mm) / 2).all(axis=1)
    outside = pressure[~seen].sum() / pressure.sum()
    if outside <= 0.5:
        return []
    return [
        f"{100 * outside:.0f} % of the contact lies outside the camera's field of {scene.camera.field_mm[0]:g} x "
        f'{scene.camera.field_mm[1]:g} mm; press.touch_at = "centre" or press.offset_mm puts it into the picture'
    ]


def _slow_motion(deformation: Deformation) -> float:
    """How much longer the video takes than the press."""
    shown = len(deformation.approach) / outputs.video_fps(len(deformation.approach))
    return round(shown / max(float(deformation.time[-1]), 1e-9), 1)


def versions(names: Sequence[str] = VERSIONS_OF) -> dict[str, str | None]:
    """Installed versions of packages; None for what is not here."""
    return {name: _version(name) for name in names}


@cache
def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
