"""What the stages hand to each other: frozen dataclasses of NumPy arrays in SI units. No backend array crosses a stage boundary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelsim.errors import DatasetError, PressEnd, SolveStatus


@dataclass(frozen=True, eq=False)
class SurfaceMotion:
    """A boundary surface and how it moved over the recorded states."""

    rest: NDArray[np.float64]
    """Rest positions [m], shape (G, 3). Object: as placed at first touch."""
    faces: NDArray[np.int32]
    """Flat triangles over these nodes (each six-node face cut in four), shape (F, 3), outward."""
    displacement: NDArray[np.float64]
    """Displacements [m], shape (N, G, 3)."""
    faces6: NDArray[np.int32]
    """The six-node faces themselves, shape (F/4, 6): for sampling between nodes."""

    def least_stretches(self, state: int) -> NDArray[np.float64]:
        """The lesser in-plane stretch of each face in a state, (F,)."""

        def sides(points: NDArray[np.float64]) -> NDArray[np.float64]:
            first, second, third = np.moveaxis(points[self.faces], 1, 0)
            return np.stack([second - first, third - first], axis=2)

        inverse = np.linalg.inv(np.linalg.qr(sides(self.rest), mode="r"))  # of a face's sides at rest, in a frame of its own
        return np.linalg.svd(sides(self.rest + self.displacement[state]) @ inverse, compute_uv=False)[:, 1].astype(np.float64)


@dataclass(frozen=True)
class ErrorEstimate:
    """How well a press is known, by its own mesh."""

    force: float
    """Relative error of the normal force."""
    membrane_um: float
    """Error of the membrane's heights [µm]."""


@dataclass(frozen=True)
class EnergyReport:
    """Where the work of a press went (`gelsim.fem.energy`): work = stored - changed + dissipated + overlap, but for the drift."""

    work_j: float = 0.0
    """Of the platen [J]."""
    stored_j: float = 0.0
    """In both bodies at the end [J]; of solids that remember, what they lost too."""
    dissipated_j: float = 0.0
    """By friction [J]."""
    overlap_j: float = 0.0
    """Held by the overlap of the bodies [J]."""
    changed_j: float = 0.0
    """What the stored energy grew by where a press went on by another way [J]."""
    drift: float = 0.0
    """Share of the work done that is in none of these."""


@dataclass(frozen=True)
class SolveReport:
    """How a press was solved, for report.json; None where that is not known or does not apply."""

    ended_by: PressEnd | None = None
    """What it ended at."""
    tried: int | None = None
    """Number of the try that it is, from 1 (`gelsim.fem.strategy`)."""
    went_on_from_mm: tuple[float, ...] = ()
    """Approaches [mm] from which it was gone on with in another way."""
    contact_points: int | None = None
    """Quadrature points on a face of the gel."""
    coat_n_per_m: float | None = None
    """Of the gel as it was solved, if it had one [N/m]."""
    symmetry: str | tuple[str, ...] | None = None
    """Mirror planes that reduced it, or the kind of its profile."""
    rigid_object: bool | None = None
    unknowns: int | None = None
    steps_halved: int | None = None
    """Load steps that were halved as Newton failed."""
    linear_solver: str | None = None
    factorisations: int | None = None
    """Matrices factorised."""
    stress_jump: float | None = None
    """Relative jump of the stress between tets in the last state (`gelsim.fem.indicator`)."""
    energy: EnergyReport | None = None
    error_estimate: ErrorEstimate | None = None
    warnings: tuple[str, ...] = ()

    def table(self) -> dict[str, Any]:
        """What is known, as JSON has it."""
        told = {item.name: value for item in fields(self) if (value := getattr(self, item.name)) is not None}
        told |= {name: vars(told[name]).copy() for name in _PARTS if name in told}
        told |= {name: list(value) for name, value in told.items() if isinstance(value, tuple)}
        return {name: value for name, value in told.items() if value or name not in ("warnings", "went_on_from_mm")}

    @classmethod
    def from_table(cls, told: Mapping[str, Any]) -> SolveReport:
        """From what `table` gave. Names that it does not know, of another version, are left out.

        Raises:
            TypeError, ValueError: A value is none of the kind.
        """
        known = {item.name: told[item.name] for item in fields(cls) if item.name in told}
        known |= {name: kind(**known[name]) for name, kind in _PARTS.items() if name in known}
        known |= {name: tuple(value) for name, value in known.items() if isinstance(value, list)}
        if "ended_by" in known:
            known["ended_by"] = PressEnd(known["ended_by"])
        return cls(**known)


_PARTS: dict[str, type] = {"energy": EnergyReport, "error_estimate": ErrorEstimate}
"""Fields of a `SolveReport` that are tables of their own."""


@dataclass(frozen=True, eq=False)
class Deformation:
    """A solved press of N recorded states, the first is first touch without force. The whole body, also where a quarter was solved."""

    approach: NDArray[np.float64]
    """Travel of the object's base toward the window [m], shape (N,)."""
    time: NDArray[np.float64]
    """From the first state [s], shape (N,)."""
    force: NDArray[np.float64]
    """Force on the gel by the object [N], shape (N, 3)."""
    contact_area: NDArray[np.float64]
    """Area in contact [m²], projected on the window as the camera sees it, shape (N,)."""
    contact_pressure: NDArray[np.float64]
    """Pressure at the gel's outer nodes, of an area at rest [Pa], shape (N, G)."""
    gel: SurfaceMotion
    """The gel's outer (coated) surface."""
    object: SurfaceMotion
    """The object's surface."""
    min_jacobian: NDArray[np.float64]
    """Smallest det F over all quadrature points, shape (N,); NaN without finite elements."""
    penetration: NDArray[np.float64]
    """Largest overlap of the two surfaces [m], anywhere on the gel's faces, shape (N,)."""
    newton_iterations: NDArray[np.int32]
    linear_iterations: NDArray[np.int32]
    seconds: NDArray[np.float64]
    converged: NDArray[np.bool_]
    status: SolveStatus = SolveStatus.CONVERGED
    message: str = ""
    """Which step failed, the residual there, and what to try; empty when converged."""
    report: SolveReport = field(default_factory=SolveReport)

    @property
    def lost(self) -> bool:
        """Whether it ended where no equilibrium was found, short of its depth and its force."""
        return self.status is not SolveStatus.CONVERGED or self.report.ended_by is PressEnd.LOST

    @property
    def along(self) -> tuple[str, NDArray[np.float64]]:
        """What curves of the press are drawn against, with its name: approach [mm], or time [s] where that does not always grow."""
        if (np.diff(self.approach) > 0.0).all():
            return "approach [mm]", 1e3 * self.approach
        return "time [s]", self.time

    @property
    def telling(self) -> int:
        """Number of the state that shows the press best: the last that carries at least half of the largest normal force."""
        force = -self.force[:, 2]
        return int(np.flatnonzero(force >= 0.5 * force.max())[-1])

    def _repr_html_(self) -> str:
        """For notebooks: how it ended, and its force as a curve."""
        name, along = self.along
        normal, state = -self.force[:, 2], self.telling
        across = (along - along[0]) / max(float(np.ptp(along)), 1e-300)
        line = " ".join(f"{4 + 232 * x:.1f},{76 - 72 * y:.1f}" for x, y in zip(across, normal / max(normal.max(), 1e-300), strict=True))
        told = (
            f"{len(along)} states, {self.status.value}; state {state}: {1e3 * self.approach[state]:.3g} mm, {normal[state]:.3g} N, "
            f"{1e6 * self.contact_area[state]:.3g} mm²"
        )
        curve = f'<svg width="240" height="80"><polyline points="{line}" fill="none" stroke="currentColor" stroke-width="1.5"/></svg>'
        return (
            f"<div>{told}<br/>{curve}<br/>normal force, up to {normal.max():.3g} N, against {name} {along[0]:.3g} to {along[-1]:.3g}</div>"
        )

    def reporting(self, **told: Any) -> Deformation:
        """The same press with fields of its report set anew."""
        return replace(self, report=replace(self.report, **told))

    def warned(self, told: str) -> Deformation:
        """The same press with one more warning."""
        return self.reporting(warnings=(*self.report.warnings, told))


@dataclass(frozen=True, eq=False)
class PressSensitivity:
    """Derivatives of a press of N recorded states, at states whose contact pressures have come to a standstill."""

    parameters: tuple[str, ...]
    """What it was differentiated by, P names with their units: the moduli, and the approach of each state."""
    approach: NDArray[np.float64]
    """[m], shape (N,)."""
    force: NDArray[np.float64]
    """Normal force of the object on the gel, positive when it presses [N], shape (N,)."""
    force_gradient: NDArray[np.float64]
    """[N per unit of the parameter], shape (N, P)."""
    height: NDArray[np.float64]
    """Normal displacement of the gel's outer surface at the points asked for [m], shape (N, Q)."""
    height_gradient: NDArray[np.float64]
    """[m per unit of the parameter], shape (N, Q, P)."""


@dataclass(frozen=True, eq=False)
class Membrane:
    """The coated surface at one instant, ready to be drawn."""

    positions: NDArray[np.float64]
    """[m], shape (M, 3)."""
    normals: NDArray[np.float64]
    """Unit normals out of the gel (+z at rest), shape (M, 3)."""
    uv: NDArray[np.float64]
    """Material coordinates in [0, 1]² over the gel's rest rectangle, shape (M, 2): u = x/size + ½, v = y/size + ½."""
    faces: NDArray[np.int32]
    """Flat triangles, shape (F, 3)."""
    marker_centres: NDArray[np.float64]
    """[m], shape (K, 3)."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of the membrane."""

    radiance: NDArray[np.float32]
    """Linear RGB, shape (H, W, 3)."""
    image: NDArray[np.uint8]
    """8-bit sRGB, shape (H, W, 3)."""
    height: NDArray[np.float32]
    """z of the membrane seen by each pixel [m], shape (H, W); NaN where the camera sees no gel."""
    marker_pixels: NDArray[np.float64]
    """Projected marker centres (column, row) [px], shape (K, 2); NaN outside the picture."""

    def _repr_png_(self) -> bytes:
        """For notebooks: the picture."""
        import io

        from PIL import Image

        file = io.BytesIO()
        Image.fromarray(self.image).save(file, format="PNG")
        return file.getvalue()


@dataclass(frozen=True, eq=False)
class Episode:
    """One press as a learner sees it, simulated or recorded. What is unknown is NaN; the schema is in docs/datasets.md."""

    frames: NDArray[np.uint8]
    """8-bit sRGB, shape (N, H, W, 3); H = W = 0 where light was left for later."""
    background: NDArray[np.uint8]
    """The no-contact frame, shape (H, W, 3)."""
    time: NDArray[np.float64]
    """From the first frame [s], shape (N,)."""
    approach: NDArray[np.float64]
    """Travel of the object's base toward the window [m], shape (N,)."""
    force: NDArray[np.float64]
    """On the gel by the object [N], shape (N, 3)."""
    marker_pixels: NDArray[np.float64]
    """(column, row) of the marker centres [px], shape (N, K, 2); NaN outside the picture; K may be 0."""
    row: dict[str, Any]
    """The episode's line of meta/episodes.jsonl."""
    noise: NDArray[np.float64] = field(default_factory=lambda: np.zeros((3, 3)))
    """Of the camera by colour, to be drawn while training, shape (3, 3): noise after the tone curve [levels of 255], electrons of a white
    pixel (0: none), noise before the tone curve [share of white], as camera.noise_sd, full_well and read_noise of a scene."""

    def __post_init__(self) -> None:
        count = len(self.frames)
        shapes = {
            "frames": (self.frames.shape, (count, *self.background.shape)),
            "background": (self.background.shape[2:], (3,)),
            "time": (self.time.shape, (count,)),
            "approach": (self.approach.shape, (count,)),
            "force": (self.force.shape, (count, 3)),
            "marker_pixels": (self.marker_pixels.shape, (count, *self.marker_pixels.shape[1:2], 2)),
            "noise": (self.noise.shape, (3, 3)),
        }
        for name, (found, wanted) in shapes.items():
            if found != wanted:
                raise DatasetError(f"episode: {name} has shape {found}, {wanted} is wanted")
        if self.frames.dtype != np.uint8 or self.background.dtype != np.uint8:
            raise DatasetError(f"episode: frames are {self.frames.dtype} and background {self.background.dtype}, uint8 is wanted")
        if count == 0:
            raise DatasetError("episode: no frames")
