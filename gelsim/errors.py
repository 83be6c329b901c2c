"""What can go wrong, as types.

Every error that a user can cause derives from `GelsimError` and says in one line what was being done, which field, the value
with its unit, and what is allowed. How a solve ended is a value (`SolveStatus`), so that one bad scene does not end a batch.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from contextlib import contextmanager


class GelsimError(Exception):
    """Base of every error that gelsim raises on purpose."""


class SceneError(GelsimError, ValueError):
    """A field of the scene is unknown, out of range, or contradicts another."""


class MaterialError(GelsimError, ValueError):
    """A hardness or a modulus lies outside the range its relation is known for."""


@contextmanager
def within(where: str) -> Iterator[None]:
    """Errors of scene and material raised inside say first where they stand: a file, or an item of a list."""
    try:
        yield
    except (SceneError, MaterialError) as error:
        raise type(error)(f"{where}: {error}") from None


class MeshingError(GelsimError):
    """A surface cannot be filled with tetrahedra."""


class RenderError(GelsimError):
    """The renderer cannot run, or was given a scene that it cannot draw."""


class DatasetError(GelsimError):
    """An episode, a recording or a dataset on disk is not what it should be."""


class SolveError(GelsimError):
    """A press could not be solved to its end.

    Attributes:
        deformation: `gelsim.results.Deformation` of the states solved before, or None.
    """

    def __init__(self, message: str, deformation: object | None = None) -> None:
        super().__init__(message)
        self.deformation = deformation


class SolveStatus(enum.Enum):
    """How a press ended; the value is a sentence for people."""

    CONVERGED = "every state converged"
    MAX_ITERATIONS = "Newton did not converge even at the smallest load step"
    LINE_SEARCH_STALLED = "no step along the Newton direction lowered the residual"
    INVERTED_ELEMENT = "an element would have turned inside out"
    NONFINITE = "the residual is not a finite number"


class PressEnd(enum.StrEnum):
    """What a press ended at, for `ended_by` of its info."""

    FORCE = "force_n"
    DEPTH = "depth_mm"
    PATH = "path"
    LIMIT = "the farthest that a press to a force goes"
    """Half of the gel and a third of a soft body's height: no further unless a depth is given."""
    GAVE_WAY = "the object gives way"
    """Of a press to a force alone: it buckles, folds or slides off, and bears less and less."""
    BEYOND = "its force lies beyond where such presses end"
    """Of a press to a force alone: steps fail, and as its force grows it would not be borne as deep as LIMIT either."""
    SLOW = "its force lies further than its pace allows"
    """Of a press to a force alone: it would go on for hundreds of Newton iterations, by the last ones. Not tried in another way."""
    LOST = "no equilibrium found further on"
    """Also of a press to a force that counts as converged: the states on the way to where the search for the force ended."""

    @property
    def wanted(self) -> bool:
        """Whether that is what the press was asked for."""
        return self in (PressEnd.FORCE, PressEnd.DEPTH, PressEnd.PATH)
