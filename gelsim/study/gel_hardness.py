"""`gel-hardness`: which gel tells which objects apart?"""

from __future__ import annotations

from collections.abc import Sequence

from gelsim.study.definition import Study
from gelsim.work.ledger import Row

UNKNOWN = "unknown_press"
WHAT = ("change", "equal_force", "equal_depth", UNKNOWN, "unknown_radius")
PICTURES, SLOPES = (tuple(f"{signal}_{what}" for what in WHAT) for signal in ("picture", "slope"))
BASE = {
    "object": {"shape": "hemisphere", "radius_mm": 8.0},
    "press": {"force_n": 1.0, "symmetry": "axisymmetric"},
    "markers": {"layout": "none"},
    "render": {"resolution": [160, 120], "mode": "baked"},
    "camera": {"noise_sd": [2.0, 1.4, 2.5]},
    # With coarser meshes the contact's edge jitters by as much as a Shore point moves it above 70.
    "fidelity": "reference",
}


def answer(rows: Sequence[Row], study: Study) -> str:
    """Which objects each gel sees best, which gel is best for the softest and the hardest object, and what is left above 00-70.

    All for who knows neither force nor depth, as a hand that presses does not.
    """
    metric = next(metric for metric in study.metrics if metric.endswith(UNKNOWN))
    seen = {(row["gel.shore_00"], row["object.shore_00"]): row[metric] for row in rows if row.get(metric) is not None}
    if not seen:
        return "No case gave a number."
    gels, objects = (sorted({pair[i] for pair in seen}) for i in (0, 1))
    peaks = {gel: max((pair for pair in seen if pair[0] == gel), key=lambda pair: seen[pair]) for gel in gels}
    said = ", ".join(f"00-{peaks[gel][1]:g} by a gel of 00-{gel:g}" for gel in gels)
    text = f"Who knows neither force nor depth is told a Shore point best of an object of {said}."
    for name, body in (("softest", objects[0]), ("hardest", objects[-1])):
        best = max((pair for pair in seen if pair[1] == body), key=lambda pair: seen[pair])
        text += f" The {name} object, 00-{body:g}, is told apart best by the gel of 00-{best[0]:g}."
    soft = 17 if 17 in gels else gels[0]
    hard = [value / seen[peaks[gel]] for (gel, body), value in seen.items() if gel == soft and body > 70]
    if hard:
        text += f" Above 00-70 a gel of 00-{soft:g} has {100 * max(hard):.0f} % of its best left."
    return text


STUDY = Study(
    name="gel-hardness",
    question="Which hardness should a gel have, so that the sensor tells apart objects of a given hardness?",
    axes={"gel.shore_00": [10, 17, 30, 45], "object.shore_00": [10, 17, 24, 31, 40, 50, 62, 74, 86]},
    metrics=PICTURES + SLOPES,
    x="object.shore_00",
    colour="gel.shore_00",
    base=BASE,
    answer=answer,
    method="A hemisphere of 8 mm is pressed to 1 N, and its neighbours in hardness to the same force, or to the same depth. The signal is "
    "the picture in levels before rounding, baked light at 160 x 120, with a noise of 2.0, 1.4 and 2.5 of 255 in red, green and blue in "
    "each of the camera's 960 x 720 pixels; and beside it the slope of the membrane, with a noise of 0.01 a pixel. d' is that of an ideal "
    "observer of one frame, so it bounds what any method can do; it fights the camera's noise alone, and what it is said not to know: "
    "force and depth, or the object's radius too, but for 10 %. "
    "The literature disagrees by two over what a Shore number means in pascals; it cancels but for the force.",
    # Without light: measuring a sensor's light field takes longer than all presses of the small form.
    quick={
        "axes": {"gel.shore_00": [17, 45], "object.shore_00": [17, 80]},
        "metrics": SLOPES,
        "base": BASE | {"fidelity": "balanced"},
    },
)
