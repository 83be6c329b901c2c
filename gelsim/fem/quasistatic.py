"""The press as a sequence of equilibria: the object's base travels toward the gel's window, step by step.

Each step starts from the linear extrapolation of the last two states, which leaves Newton only the curvature of the path. A step that does
not converge is halved, with the friction history returned to where the step began; after two easy steps it doubles again. Recorded states
are equally spaced in approach; `force_n` ends the press at the approach (found by the secant rule) where the normal force reaches it.

Left out: inertia, gravity, viscosity. Gravity of a 25 mm silicone body is under 0.1 kPa per 10 mm of height.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import SolveError, SolveStatus
from gelsim.fem.assembly import Solids
from gelsim.fem.contact import ContactLaw, SurfaceContact
from gelsim.fem.elements import tet_quadrature_data
from gelsim.fem.indicator import FORCE_ERROR_PER_JUMP, stress_jump
from gelsim.fem.linear import single_threaded_blas
from gelsim.fem.newton import Newton, NewtonOptions
from gelsim.geometry import QuadraticSurface, TetMesh, mirror_surface, split_faces
from gelsim.materials import OGDEN_TERMS, ElasticMaterial
from gelsim.results import Deformation, SurfaceMotion
from gelsim.scene import Scene

Array = NDArray[np.float64]
MM = 1e3  # solver lengths are millimetres
KPA = 1e-3
MILLINEWTON = 1e-3  # N per solver force unit

# k·h of the contact penalty over E of the softest body, and its smoothing. docs/validation.md shows what three times less or more changes.
PENALTY_PER_MODULUS = 30.0
PENALTY_SMOOTHING_MM = 5e-4
STICK_PER_MODULUS = 10.0  # k_t·h of friction over E
MAX_AUGMENTATIONS = 4  # a step; one is usual, as the multipliers start from the last two steps' extrapolation
TOLERANCES = {"fast": 3e-4, "balanced": 1e-4, "reference": 1e-6}  # imbalance left by Newton; a force is off by a fraction of it
ROUGH_TOLERANCE = 2e-2  # of the first solve of a step, before the multipliers move
OVERLAP_MM = 5e-3  # overlap above which another is tried
# Pressure, as a share of the largest, from which a point counts as in contact: the linear multipliers smear a little load over the rim's last faces.
# Hertz's pressure falls below 5 % only in the outer 0.13 % of the radius.
AREA_THRESHOLD = 0.05
SMALLEST_STEP = 1 / 64  # of the spacing of recorded states


@dataclass(frozen=True)
class _Motion:
    """Where the object's base is at an approach s in [0, end] m: travel, shear in proportion, twist about the object's axis."""

    end: float
    shear: tuple[float, float]
    twist: float
    axis: Array

    def __call__(self, points: Array, s: float) -> Array:
        """Displacement [mm] of points (N, 3) [mm] moving with the base."""
        part = s / self.end if self.end else 0.0
        angle = self.twist * part
        c, si = np.cos(angle), np.sin(angle)
        relative = points - self.axis
        turned = np.stack([c * relative[:, 0] - si * relative[:, 1], si * relative[:, 0] + c * relative[:, 1], relative[:, 2]], 1)
        return turned - relative + np.array([self.shear[0] * part, self.shear[1] * part, -s]) * MM


class PressProblem:
    """A scene made ready for Newton: numbering, supports, materials, contact."""

    def __init__(self, scene: Scene, gel: TetMesh, body: TetMesh | QuadraticSurface, placement: tuple[Array, Array],
                 gel_material: ElasticMaterial, object_material: ElasticMaterial | None, device: str, *, tet_points: int = 4,
                 contact_points: int = 6, tolerance: float | None = None) -> None:  # fmt: skip
        self.scene, self.gel, self.body = scene, gel, body
        rotation, translation = placement
        gel_rest = gel.rest_positions * MM
        n = len(gel_rest)
        if isinstance(body, TetMesh):
            nodes, object_faces = body.rest_positions, body.groups["contact"]
        else:
            nodes, object_faces = body.nodes, body.faces
        object_rest = (nodes @ np.asarray(rotation).T + np.asarray(translation)) * MM
        rest = np.concatenate([gel_rest, object_rest])
        self.object_nodes = np.arange(n, len(rest))
        fixed = np.zeros((len(rest), 3), bool)
        fixed[gel.groups["bonded"]] = True
        for axis, column in (("x", 0), ("y", 1)):
            if axis in gel.symmetry:
                fixed[:, column] |= np.abs(rest[:, column]) < 1e-9
        meshes = [(gel, gel_material, 0)]
        if isinstance(body, TetMesh):
            assert object_material is not None
            self.driven = n + np.unique(body.groups["base"])
            meshes.append((body, object_material, n))
        else:
            self.driven = self.object_nodes
        fixed[self.driven] = True

        parts = []
        ogden = any(material.law == "ogden" for _, material, _ in meshes)
        for mesh, material, shift in meshes:
            data = tet_quadrature_data(TetMesh((rest[shift : shift + len(mesh.rest_positions)]), mesh.tets), tet_points)
            count = len(mesh.tets)
            law = np.tile(isochoric_constants(material, ogden), (count, 1))
            parts.append((mesh.tets + shift, data, law, np.full(count, material.kappa * KPA)))
        data = parts[0][1]
        if len(parts) > 1:
            data = type(data)(*(np.concatenate([getattr(p[1], f) for p in parts]) for f in ("gradients", "weights")), data.pressure_shape)
        tets, law, kappa = (np.concatenate([p[i] for p in parts]) for i in (0, 2, 3))
        self.solids = Solids(rest, tets.astype(np.int32), data, law, kappa, fixed, device)
        self.quadrature = data
        self.shear = np.concatenate([np.full(len(mesh.tets), material.mu * KPA) for mesh, material, _ in meshes])
        softest = min(m.youngs_modulus for _, m, _ in meshes) * KPA
        stiffness = PENALTY_PER_MODULUS * softest
        mu = scene.contact.friction_coefficient
        friction = -1.0 if mu == "stick" else float(mu)
        self.law = ContactLaw(stiffness, PENALTY_SMOOTHING_MM, friction, STICK_PER_MODULUS * softest)
        faces = (object_faces + n).astype(np.int32)
        self.contact = SurfaceContact(gel.groups["coated"], faces, rest, self.law, device, contact_points, gel.symmetry)
        self.newton = Newton(self.solids, self.contact, NewtonOptions(tolerance or TOLERANCES[scene.fidelity]))
        self.copies = 2 ** len(gel.symmetry)

    def contact_force(self) -> Array:
        """Force on the gel by the object [N], the whole body's."""
        c = self.contact
        local = c.pressure.numpy()[:, None] * c.normal.numpy() + (c.traction.numpy() if c.frictional else 0.0)
        force = (c.rest_weight[:, None] * np.where(c.pressure.numpy()[:, None] > 0, local, 0.0)).sum(0) * self.copies
        for axis, column in (("x", 0), ("y", 1)):
            if axis in self.gel.symmetry:
                force[column] = 0.0
        return force * MILLINEWTON

    def support_force(self) -> Array:
        """Reaction [N] of the window on the gel, for the force balance: equal and opposite to `contact_force` at equilibrium."""
        internal, _, _ = self.solids.internal_force()
        force = internal[np.unique(self.gel.groups["bonded"])].sum(0) * self.copies
        for axis, column in (("x", 0), ("y", 1)):
            if axis in self.gel.symmetry:
                force[column] = 0.0
        return force * MILLINEWTON


def isochoric_constants(material: ElasticMaterial, ogden: bool = False) -> Array:
    """The constants [kPa] that `Solids` takes: (c₁, c₂, c₃), or of an Ogden law (μ₁, α₁, …), padded with terms of μ = 0.

    `ogden`: in Ogden's form whatever the law, for a neo-Hookean solid beside one of Ogden's; α = 2 is the same law.
    """
    if material.law == "ogden" or ogden:
        assert material.law != "yeoh", "a cubic has no Ogden form"
        alpha, weight = np.reshape(material.constants, (-1, 2)).T if material.law == "ogden" else ([2.0], [1.0])
        constants = np.tile([0.0, 2.0], OGDEN_TERMS)
        constants[: 2 * len(alpha)] = np.column_stack([material.mu * KPA * np.asarray(weight), alpha]).ravel()
        return constants
    return material.mu / 2 * KPA * np.array([1.0, *(material.constants or (0.0, 0.0))])


@dataclass
class _Recorded:
    approach: list[float]
    force: list[Array]
    area: list[float]
    pressure: list[Array]
    displacement: list[Array]
    min_jacobian: list[float]
    penetration: list[float]
    newton: list[int]
    linear: list[int]
    seconds: list[float]


def run_press(problem: PressProblem, *, progress=None, throw: bool = True) -> Deformation:  # type: ignore[no-untyped-def]
    """Solves a press. `progress(done, total)` is called after each recorded state."""
    with single_threaded_blas():
        return _march(problem, progress, throw)


def _march(problem: PressProblem, progress, throw: bool) -> Deformation:  # type: ignore[no-untyped-def]
    scene, solids, contact, newton = problem.scene, problem.solids, problem.contact, problem.newton
    press = scene.press
    depth = (press.depth_mm if press.depth_mm is not None else _depth_limit(scene)) / MM
    motion = _Motion(
        depth, (press.shear_mm[0] / MM, press.shear_mm[1] / MM), np.deg2rad(press.twist_deg),
        np.array([press.offset_mm[0], press.offset_mm[1], 0.0]),
    )  # fmt: skip
    driven_rest = solids.rest[problem.driven]
    object_rest = solids.rest[problem.object_nodes]
    spacing = depth / (press.frames - 1)
    record = _Recorded([], [], [], [], [], [], [], [], [], [])
    clock = time.perf_counter()
    status, message = SolveStatus.CONVERGED, ""

    def keep(s: float, iterations: int, factorisations: int) -> None:
        nonlocal clock
        now = time.perf_counter()
        record.approach.append(s)
        record.force.append(problem.contact_force())
        area, pressure = _area_and_pressure(problem)
        record.area.append(area)
        record.pressure.append(pressure)
        record.displacement.append(solids.displacement.numpy() / MM)
        record.min_jacobian.append(solids.internal_force()[2])
        gap = contact.gap.numpy()
        record.penetration.append(max(0.0, -float(gap.min())) / MM)
        record.newton.append(iterations)
        record.linear.append(factorisations)
        record.seconds.append(now - clock)
        clock = now
        if progress is not None:
            progress(len(record.approach), press.frames)

    newton.residual(1.0)  # first touch
    contact.settle()
    keep(0.0, 0, 0)
    s, step, easy = 0.0, spacing, 0
    previous: tuple[float, tuple[Array, Array], Array] | None = None
    normal_force = 0.0
    stopped = False
    halved = 0
    iterations = factorisations = 0
    while not stopped and s < depth * (1 - 1e-12):
        target = spacing * len(record.approach)
        if target - (s + step) < 1e-6 * spacing:
            step_now = target - s
        else:
            step_now = step
        start, history = solids.state(), contact.save()

        def attempt(new: float, start=start, history=history) -> bool:
            """Solves at approach `new` from the state `start` at s; False leaves that state as it was."""
            nonlocal iterations, factorisations, status, message
            if previous is not None:
                ratio = (new - s) / (s - previous[0])
                contact.set_multipliers(history[2] + ratio * (history[2] - previous[2]))
            solids.set_state(_predict(problem, motion, s, start, previous, new, driven_rest, object_rest))
            reach = 1.0 + 2 * (new - s) * MM
            before = newton.system.factorisations
            report = newton.solve(reach, tolerance=ROUGH_TOLERANCE)
            iterations += report.iterations
            overlap = np.inf
            for _ in range(MAX_AUGMENTATIONS):
                if report.status is not SolveStatus.CONVERGED:
                    break
                contact.augment()
                report = newton.solve(reach)
                iterations += report.iterations
                before_this, overlap = overlap, -float(contact.gap.numpy().min())
                if overlap <= OVERLAP_MM or overlap > 0.7 * before_this:  # where a sharp edge cuts in, linear multipliers cannot do better
                    break
            factorisations += newton.system.factorisations - before
            if report.status is SolveStatus.CONVERGED:
                return True
            status = report.status
            message = f"at approach {new * MM:.4g} mm after {report.iterations} iterations, residual {report.residual:.2g}"
            solids.set_state(start)
            contact.restore(history)
            return False

        if not attempt(s + step_now):
            step, easy, halved = step_now / 2, 0, halved + 1
            if step < SMALLEST_STEP * spacing:
                break
            continue
        status = SolveStatus.CONVERGED
        force = -problem.contact_force()[2]
        new = s + step_now
        if press.force_n is not None and force >= press.force_n:
            new, stopped = _stop_at_force(problem, attempt, (s, normal_force), (new, force), press.force_n), True
        contact.settle()
        previous = (s, start, history[2])
        s, normal_force = new, force
        easy += 1
        if easy >= 2 and step < spacing:
            step, easy = min(2 * step, spacing), 0
        if stopped or abs(s - target) < 1e-9 * spacing:
            keep(s, iterations, factorisations)
            iterations = factorisations = 0
    deformation = _deformation(problem, record, status, message, halved)
    if status is not SolveStatus.CONVERGED and throw:
        raise SolveError(
            f"press stopped {message}: {status.value}; {len(record.approach) - 1} of {press.frames - 1} steps were solved and kept. "
            "Try more frames, a smaller depth_mm, or --fidelity fast to see where it goes",
            deformation,
        )
    return deformation


def _depth_limit(scene: Scene) -> float:
    """How far [mm] a press may go when only a force ends it: half of the gel plus a third of a soft object's height."""
    return 0.5 * scene.gel.thickness_mm + (0.0 if scene.object.rigid else scene.object.height_mm / 3)


def _predict(problem, motion, s, start, previous, new, driven_rest, object_rest):  # type: ignore[no-untyped-def]
    """The state to start Newton from at approach `new`: prescribed nodes exactly, the rest extrapolated."""
    u, p = start[0].copy(), start[1].copy()
    if previous is not None and s > previous[0]:
        ratio = (new - s) / (s - previous[0])
        u += ratio * (start[0] - previous[1][0])
        p += ratio * (start[1] - previous[1][1])
    else:
        u[problem.object_nodes] += motion(object_rest, new) - motion(object_rest, s)
    u[problem.driven] = motion(driven_rest, new)
    return u, p


def _stop_at_force(problem, attempt, low, high, wanted):  # type: ignore[no-untyped-def]
    """Approach at which the normal force is `wanted` within 0.2 %; leaves the solids there."""
    for _ in range(12):
        if abs(high[1] - wanted) <= 2e-3 * wanted:
            break
        fraction = (wanted - low[1]) / (high[1] - low[1])
        middle = low[0] + np.clip(fraction, 0.02, 0.98) * (high[0] - low[0])
        if not attempt(middle):
            raise AssertionError("a shorter step failed where a longer one converged")
        force = -problem.contact_force()[2]
        if force >= wanted or abs(force - wanted) <= 2e-3 * wanted:
            high = (middle, force)
        else:
            low = (middle, force)
    return high[0]


def _area_and_pressure(problem: PressProblem) -> tuple[float, Array]:
    """Area in contact [m²] of the whole body, and pressure [Pa] at all nodes (zero off the coated face)."""
    contact, solids = problem.contact, problem.solids
    from gelsim.fem.elements import tri6_gradient, triangle_quadrature

    bary, rule = triangle_quadrature(contact.points)
    x = solids.rest + solids.displacement.numpy()
    tangents = np.einsum("fni,qnj->fqij", x[contact.gel_faces], tri6_gradient(bary))
    current = np.linalg.norm(np.cross(tangents[..., 0], tangents[..., 1]), axis=-1) * rule
    pressure = contact.pressure.numpy()
    area = current.ravel()[pressure > AREA_THRESHOLD * pressure.max()].sum() * problem.copies / MM**2
    hats = _hats(bary)
    weight = contact.rest_weight.reshape(len(contact.gel_faces), -1)
    top = np.einsum("fq,qa->fa", weight * pressure.reshape(weight.shape), hats)
    bottom = np.einsum("fq,qa->fa", weight, hats)
    n = solids.node_count
    total = np.bincount(contact.gel_faces.ravel(), bottom.ravel(), n)
    mean = np.bincount(contact.gel_faces.ravel(), top.ravel(), n) / np.where(total > 0, total, 1.0)
    return float(area), mean / KPA


def _hats(bary: Array) -> Array:
    """Piecewise linear hat functions of the four sub-triangles of a six-node face, (Q, 6): positive weights to average with."""
    values = np.zeros((len(bary), 6))
    for q, b in enumerate(bary):
        corner = int(np.argmax(b))
        if b[corner] >= 0.5:
            others = [(corner + 1) % 3, (corner + 2) % 3]
            values[q, corner] = 2 * b[corner] - 1
            for o in others:
                values[q, 3 + {(0, 1): 0, (1, 2): 1, (0, 2): 2}[(min(corner, o), max(corner, o))]] = 2 * b[o]
        else:
            values[q, 3:] = [1 - 2 * b[2], 1 - 2 * b[0], 1 - 2 * b[1]]
    return values


def _whole(surface: QuadraticSurface, displacement: Array, scalar: Array | None, symmetry: frozenset[str]):  # type: ignore[no-untyped-def]
    """Reflects a surface and its fields at the symmetry planes."""
    for axis in sorted(symmetry):
        column = "xy".index(axis)
        count = len(surface.nodes)
        mirrored = mirror_surface(surface, axis)
        image = np.arange(count)[np.abs(surface.nodes[:, column]) > 0]
        flipped = displacement[:, image].copy()
        flipped[..., column] *= -1
        displacement = np.concatenate([displacement, flipped], axis=1)
        if scalar is not None:
            scalar = np.concatenate([scalar, scalar[:, image]], axis=1)
        surface = mirrored
        assert len(surface.nodes) == displacement.shape[1]
    return surface, displacement, scalar


def _deformation(problem: PressProblem, record: _Recorded, status: SolveStatus, message: str, halved: int) -> Deformation:
    gel, body = problem.gel, problem.body
    everything = np.array(record.displacement)
    coated = np.unique(gel.groups["coated"])
    surface, displacement, pressure = _whole(
        gel.surface("coated"), everything[:, coated], np.array(record.pressure)[:, coated], gel.symmetry
    )
    gel_motion = SurfaceMotion(surface.nodes, split_faces(surface.faces), displacement, surface.faces)
    if isinstance(body, TetMesh):
        used = np.unique(body.groups["contact"])
        local = body.surface("contact")
    else:
        used = np.arange(len(body.nodes))
        local = body
    placed = QuadraticSurface(problem.solids.rest[problem.object_nodes[used]] / MM, local.faces)
    surface, displacement, _ = _whole(placed, everything[:, problem.object_nodes[used]], None, gel.symmetry)
    object_motion = SurfaceMotion(surface.nodes, split_faces(surface.faces), displacement, surface.faces)
    count = len(record.approach)
    jump = stress_jump(problem.solids.tets, problem.quadrature, problem.shear, problem.solids.displacement.numpy())
    return Deformation(
        approach=np.array(record.approach), force=np.array(record.force), contact_area=np.array(record.area),
        contact_pressure=pressure, gel=gel_motion, object=object_motion, min_jacobian=np.array(record.min_jacobian),
        penetration=np.array(record.penetration), newton_iterations=np.array(record.newton, np.int32),
        linear_iterations=np.array(record.linear, np.int32), seconds=np.array(record.seconds), converged=np.ones(count, bool),
        status=status, message=message,
        info={
            "unknowns": problem.solids.unknowns, "steps_halved": halved, "symmetry": sorted(gel.symmetry),
            "linear_solver": problem.newton.system.direct.name, "factorisations": problem.newton.system.factorisations, "solves": problem.newton.system.solves,
            "rigid_object": not isinstance(body, TetMesh),
            "stress_jump": jump,
            "error_estimate": {"force": FORCE_ERROR_PER_JUMP * jump},
        },
    )  # fmt: skip
