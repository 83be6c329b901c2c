"""Elastic constants from what people know of a silicone: a durometer reading, or Young's modulus.

    Shore 00   E = 9 F / (16 sqrt(R) d^1.5),  F = 0.203 + 0.00908 H [N],  d = 2.54 (1 - H/100) [mm],  R = 1.19 mm
               Hertz contact of the type-00 indenter (a ball tip; spring and travel of ASTM D2240) on an incompressible half-space.
    Shore A    log10 E[MPa] = 0.0235 S - 0.6403, trusted for 20..80 (Qi, Joyce and Boyce 2003, Rubber Chem. Technol. 76:419).

The two agree where the scales meet: Shore A 45 gives 2.61 MPa, which is Shore 00 86.7; Yuan et al. (ICRA 2017) say 87. Left out: finite
depth of the indenter (stiffer, up to 40 %), the presser foot (softer, up to 22 %), friction (softer), thickness, time. So the relation is a
definition of "the modulus a durometer sees"; by finite elements of all three it is 0.85 ± 0.15 of it (`gelsim.durometer`), while tensile
tests of the same silicones read 30-65 %. Hence `modulus_scale`, a factor on both. docs/physics.md has the numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from gelsim.errors import MaterialError
from gelsim.units import KPA, unit_of

# Type 00 durometer, ASTM D2240.
TIP_RADIUS = 1.19e-3
"""Radius of the ball tip [m]."""
TRAVEL = 2.54e-3
"""Protrusion of the tip at reading 0 [m]."""
SPRING_PRELOAD = 0.203
"""Spring force at reading 0 [N]."""
SPRING_RATE = 0.00908
"""Spring force per Shore point [N]."""

SHORE_00_RANGE = (1.0, 99.0)
"""Accepted readings; ASTM D2240 trusts 10..90. At 0 the tip is all out, at 100 the relation diverges."""
SHORE_A_RANGE = (20.0, 80.0)
"""Range of the Shore A relation."""
_QI_SLOPE, _QI_OFFSET = 0.0235, -0.6403

LAWS = ("neo-hookean", "yeoh", "ogden")
"""Isochoric laws that the mechanics has."""
LAW_CONSTANTS = {"neo-hookean": (), "yeoh": ("c2_over_c1", "c3_over_c1"), "ogden": ("alpha", "weight")}
"""What each law takes from [object.law_constants]; a single `alpha` needs no `weight`."""
OGDEN_TERMS = 3
"""The most terms that an Ogden law may have."""
SMALLEST_ALPHA = 0.1
"""Of an Ogden exponent's size: at 0 the law turns logarithmic, and 2 mu/alpha^2 loses its digits."""
YEOH_REACH = 10.0
"""Up to this excess of I1bar over 3 (a pull to 3.4 times, a squash to a fifth) a Yeoh law must still resist."""


@dataclass(frozen=True)
class ElasticMaterial:
    """Constants of W = What + (kappa/2)(J - 1)^2, What by the law, its small-strain shear modulus mu:

    neo-hookean   (mu/2)(I1bar - 3),  I1bar = J^(-2/3) I1
    yeoh          c1 [e + (c2/c1) e^2 + (c3/c1) e^3],  e = I1bar - 3,  c1 = mu/2
    ogden         sum_k 2 mu_k/alpha_k^2 (sum_j lbar_j^alpha_k - 3),  mu_k = weight_k mu,  lbar = J^(-1/3) lambda
    """

    mu: float
    """Shear modulus [Pa]."""
    kappa: float
    """Bulk modulus [Pa]."""
    law: str = "neo-hookean"
    """The isochoric part, one of LAWS."""
    constants: tuple[float, ...] = ()
    """The shape of its curve, all ratios: c2/c1, c3/c1 of yeoh; alpha_1, weight_1, alpha_2, weight_2 ... of ogden, weights of sum 1."""
    prony: tuple[tuple[float, float], ...] = ()
    """(share g, time tau [s]) of what relaxes: mu(t) = mu (1 - sum g (1 - exp(-t/tau))); none = elastic."""

    @classmethod
    def from_modulus(
        cls,
        youngs_modulus: float,
        poissons_ratio: float,
        law: str = "neo-hookean",
        constants: tuple[float, ...] = (),
        prony: tuple[tuple[float, float], ...] = (),
    ) -> ElasticMaterial:
        """From Young's modulus [Pa] and Poisson's ratio in [0, 0.5): mu = E/(2(1+v)), kappa = E/(3(1-2v)), whatever the law.

        Raises:
            MaterialError: E is not positive, or v outside [0, 0.5).
        """
        if not (math.isfinite(youngs_modulus) and youngs_modulus > 0.0):
            raise MaterialError(f"Young's modulus = {youngs_modulus:g} Pa: it must be positive")
        if not 0.0 <= poissons_ratio < 0.5:
            raise MaterialError(f"Poisson's ratio = {poissons_ratio:g}: allowed is 0 ≤ v < 0.5")
        mu, kappa = youngs_modulus / (2.0 * (1.0 + poissons_ratio)), youngs_modulus / (3.0 * (1.0 - 2.0 * poissons_ratio))
        return cls(mu, kappa, law, constants, prony)

    @property
    def youngs_modulus(self) -> float:
        """Small-strain Young's modulus [Pa]: 9 kappa mu / (3 kappa + mu)."""
        return 9.0 * self.kappa * self.mu / (3.0 * self.kappa + self.mu)

    @property
    def poissons_ratio(self) -> float:
        """Small-strain Poisson's ratio: (3 kappa - 2 mu) / (2 (3 kappa + mu))."""
        return (3.0 * self.kappa - 2.0 * self.mu) / (2.0 * (3.0 * self.kappa + self.mu))


def modulus_from_shore_00(shore: float) -> float:
    """Young's modulus [Pa] that a type-00 durometer reading stands for (Hertz; head of this module).

    Args:
        shore: Reading [Shore 00], accepted for 1..99, trusted for 10..90.
    Raises:
        MaterialError: Reading outside 1..99.
    """
    _check_reading(shore, SHORE_00_RANGE, "Shore 00")
    force = SPRING_PRELOAD + SPRING_RATE * shore
    depth = TRAVEL * (1.0 - shore / 100.0)
    return 9.0 * force / (16.0 * math.sqrt(TIP_RADIUS) * depth**1.5)


def modulus_from_shore_a(shore: float) -> float:
    """Young's modulus [Pa] from a type-A durometer reading (Qi et al. 2003; head of this module).

    Args:
        shore: Reading [Shore A], 20..80.
    Raises:
        MaterialError: Reading outside 20..80: softer silicones belong on the 00 scale.
    """
    _check_reading(shore, SHORE_A_RANGE, "Shore A")
    return 1e6 * 10.0 ** (_QI_SLOPE * shore + _QI_OFFSET)


def shore_00_from_modulus(youngs_modulus: float) -> float:
    """The Shore 00 reading of a silicone of this Young's modulus [Pa]; inverse of `modulus_from_shore_00`.

    Raises:
        MaterialError: The reading would lie outside 1..99.
    """
    low, high = SHORE_00_RANGE
    if not modulus_from_shore_00(low) <= youngs_modulus <= modulus_from_shore_00(high):
        raise MaterialError(_no_reading(youngs_modulus, modulus_from_shore_00(low), modulus_from_shore_00(high), "Shore 00"))
    # E grows strictly with H (force up, depth down): bisection to the last bit of a float takes 60 halvings.
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if modulus_from_shore_00(middle) < youngs_modulus else (low, middle)
    return 0.5 * (low + high)


def shore_a_from_modulus(youngs_modulus: float) -> float:
    """The Shore A reading of a silicone of this Young's modulus [Pa]; inverse of `modulus_from_shore_a`.

    Raises:
        MaterialError: The reading would lie outside 20..80.
    """
    low, high = (modulus_from_shore_a(shore) for shore in SHORE_A_RANGE)
    # A relative 1e-12 lets the ends of the range through their own rounding.
    if not low * (1.0 - 1e-12) <= youngs_modulus <= high * (1.0 + 1e-12):
        raise MaterialError(_no_reading(youngs_modulus, low, high, "Shore A"))
    return (math.log10(youngs_modulus / 1e6) - _QI_OFFSET) / _QI_SLOPE


class Hard(Protocol):
    """What has a hardness: [gel], [object], [object.skin], [object.grains]."""

    @property
    def shore_00(self) -> float | None: ...
    @property
    def shore_a(self) -> float | None: ...
    @property
    def youngs_modulus_kpa(self) -> float | None: ...
    @property
    def modulus_scale(self) -> float: ...


class Elastic(Hard, Protocol):
    """What [gel] and [object] have in common."""

    @property
    def poissons_ratio(self) -> float: ...
    @property
    def prony_g(self) -> tuple[float, ...]: ...
    @property
    def prony_tau_s(self) -> tuple[float, ...]: ...


class _Skin(Hard, Protocol):
    @property
    def thickness_mm(self) -> float: ...


class _Grains(Hard, Protocol):
    @property
    def count(self) -> int: ...


class LawConstants(Protocol):
    """[object.law_constants]; None and () where not given."""

    @property
    def c2_over_c1(self) -> float | None: ...
    @property
    def c3_over_c1(self) -> float | None: ...
    @property
    def alpha(self) -> tuple[float, ...]: ...
    @property
    def weight(self) -> tuple[float, ...]: ...


class _ElasticBody(Elastic, Protocol):
    @property
    def rigid(self) -> bool: ...
    @property
    def law(self) -> str: ...
    @property
    def law_constants(self) -> LawConstants: ...
    @property
    def skin(self) -> _Skin: ...
    @property
    def grains(self) -> _Grains: ...


class _Pressed(Protocol):
    @property
    def gel(self) -> Elastic: ...
    @property
    def object(self) -> _ElasticBody: ...


def youngs_modulus(section: Hard) -> float:
    """Young's modulus [Pa] of a gel, an object or a part of it, from whichever of shore_00, shore_a and youngs_modulus_kpa it gives.

    `modulus_scale` multiplies what a reading gives, not a modulus that was given as such.

    Raises:
        MaterialError: A reading outside the range of its relation, or none of the three given.
    """
    if section.youngs_modulus_kpa is not None:
        return section.youngs_modulus_kpa * KPA
    if section.shore_00 is not None:
        return section.modulus_scale * modulus_from_shore_00(section.shore_00)
    if section.shore_a is not None:
        return section.modulus_scale * modulus_from_shore_a(section.shore_a)
    raise MaterialError("no hardness given: one of shore_00, shore_a and youngs_modulus_kpa is needed")


def prony_series(section: Elastic) -> tuple[tuple[float, float], ...]:
    """(share, time [s]) of what relaxes.

    Raises:
        MaterialError: As many shares as times, each positive, the shares of sum below 1; the message begins with the field's name.
    """
    if len(section.prony_g) != len(section.prony_tau_s):
        raise MaterialError(f"prony_g has {len(section.prony_g)} values, prony_tau_s {len(section.prony_tau_s)}: give one for each")
    for share in section.prony_g:
        if share <= 0.0:
            raise MaterialError(f"prony_g = {share:g}: a share must be positive")
    if math.fsum(section.prony_g) >= 1.0:
        raise MaterialError(f"prony_g sums to {math.fsum(section.prony_g):g}: it must stay below 1, or nothing carries a load that lasts")
    return tuple(zip(section.prony_g, section.prony_tau_s, strict=True))


def gel_material(scene: _Pressed) -> ElasticMaterial:
    """The gel's constants."""
    return ElasticMaterial.from_modulus(youngs_modulus(scene.gel), scene.gel.poissons_ratio, prony=prony_series(scene.gel))


def parts(body: _ElasticBody) -> tuple[str, ...]:
    """What an object is made of, in the order in which its mesh numbers them (`TetMesh.regions`): "body", "skin", "grains"."""
    skin, grains = body.skin.thickness_mm > 0.0, body.grains.count > 0
    return ("body", *(("skin",) if skin else ()), *(("grains",) if grains else ()))


def object_materials(scene: _Pressed) -> dict[str, ElasticMaterial]:
    """The constants of each of an object's `parts`, which differ in their modulus alone; empty when it is rigid."""
    body = scene.object
    if body.rigid:
        return {}
    sections: dict[str, Hard] = {"body": body, "skin": body.skin, "grains": body.grains}
    constants, prony = law_shape(body.law, body.law_constants), prony_series(body)
    return {
        name: ElasticMaterial.from_modulus(youngs_modulus(sections[name]), body.poissons_ratio, body.law, constants, prony)
        for name in parts(body)
    }


def object_material(scene: _Pressed) -> ElasticMaterial | None:
    """The constants of an object's body; None when it is rigid."""
    return object_materials(scene).get("body")


def press_materials(scene: _Pressed) -> tuple[ElasticMaterial, ...]:
    """The gel's constants, then those of the object's `parts`."""
    return (gel_material(scene), *object_materials(scene).values())


def law_shape(law: str, given: LawConstants) -> tuple[float, ...]:
    """`ElasticMaterial.constants` of a law from what [object.law_constants] gives.

    Raises:
        MaterialError: A constant is missing, belongs to another law, or is out of range; the message begins with its name.
    """
    for name in sorted({name for names in LAW_CONSTANTS.values() for name in names}):
        present = getattr(given, name) not in (None, ())
        if present and name not in LAW_CONSTANTS[law]:
            owner = next(owner for owner, names in LAW_CONSTANTS.items() if name in names)
            raise MaterialError(f'{name} is a constant of law = "{owner}", but law = "{law}"')
        if not present and name in LAW_CONSTANTS[law] and not (name == "weight" and len(given.alpha) <= 1):
            raise MaterialError(f'{name} is missing: law = "{law}" needs {" and ".join(LAW_CONSTANTS[law])}')
    if law == "yeoh":
        assert given.c2_over_c1 is not None and given.c3_over_c1 is not None
        _check_yeoh(given.c2_over_c1, given.c3_over_c1)
        return given.c2_over_c1, given.c3_over_c1
    if law == "ogden":
        weight = given.weight or (1.0,)
        _check_ogden(given.alpha, weight)
        # a sum of 0.333 + 0.333 + 0.333 is meant to be one
        return tuple(value for a, w in zip(given.alpha, weight, strict=True) for value in (a, w / math.fsum(weight)))
    return ()


def _check_yeoh(second: float, third: float) -> None:
    """1 + 2 (c2/c1) e + 3 (c3/c1) e^2 > 0 for 0 <= e <= YEOH_REACH: the stiffness dWhat/dI1bar stays positive."""
    places = [YEOH_REACH] + ([-second / (3.0 * third)] if third > 0.0 and 0.0 < -second / (3.0 * third) < YEOH_REACH else [])
    for place in places:
        if 1.0 + 2.0 * second * place + 3.0 * third * place * place <= 0.0:
            name, value = ("c2_over_c1", second) if second < 0.0 else ("c3_over_c1", third)
            raise MaterialError(f"{name} = {value:g}: the law gives way before I1 exceeds 3 by {YEOH_REACH:g}; raise it")


def _check_ogden(alpha: tuple[float, ...], weight: tuple[float, ...]) -> None:
    if len(alpha) > OGDEN_TERMS:
        raise MaterialError(f"alpha has {len(alpha)} values: allowed are 1 … {OGDEN_TERMS}")
    if len(weight) != len(alpha):
        raise MaterialError(f"weight has {len(weight)} values, alpha {len(alpha)}: give one for each alpha")
    for value in alpha:
        if abs(value) < SMALLEST_ALPHA:
            raise MaterialError(f"alpha = {value:g}: its size must be at least {SMALLEST_ALPHA:g}")
    for value in weight:
        if value <= 0.0:
            raise MaterialError(f"weight = {value:g}: it must be positive")
    if abs(math.fsum(weight) - 1.0) > 0.01:
        raise MaterialError(f"weight sums to {math.fsum(weight):g}: weights are shares of the shear modulus, of sum 1")


def hardness_label(section: Hard) -> str:
    """The hardness in words: "Shore 00-30", "Shore A 45", "E = 100 kPa"."""
    if section.youngs_modulus_kpa is not None:
        return f"E = {section.youngs_modulus_kpa:g} {unit_of('youngs_modulus_kpa')}"
    return f"Shore 00-{section.shore_00:g}" if section.shore_00 is not None else f"Shore A {section.shore_a:g}"


def _check_reading(shore: float, allowed: tuple[float, float], scale: str) -> None:
    low, high = allowed
    if not low <= shore <= high:
        hint = "; softer silicones belong on the 00 scale" if scale == "Shore A" and shore < low else ""
        raise MaterialError(f"{scale} reading {shore:g}: allowed is {low:g} … {high:g}{hint}")


def _no_reading(modulus: float, low: float, high: float, scale: str) -> str:
    return f"E = {modulus / KPA:g} kPa has no {scale} reading: the relation covers {low / KPA:.4g} … {high / KPA:.4g} kPa"
