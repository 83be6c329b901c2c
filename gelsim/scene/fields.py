"""Fields of frozen dataclasses by their type hints: plain values, of TOML, flags or Python, to typed ones, with errors that name the field.

Which fields there are, and what they may be, is not said here (`gelsim.scene.definition`, `gelsim.scene.limits`).
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import math
import tomllib
import types
import typing

from gelsim.errors import SceneError, within


@functools.cache
def field_types(section: type) -> dict[str, typing.Any]:
    """Field name -> resolved type of a dataclass."""
    hints = typing.get_type_hints(section)
    return {item.name: hints[item.name] for item in dataclasses.fields(section)}


def nearest(name: str, known: typing.Iterable[str]) -> str:
    """ ", did you mean …?" for a misspelt name, or "" when nothing known comes near."""
    folded = {item.casefold(): item for item in known}
    match = difflib.get_close_matches(name.casefold(), folded, n=1, cutoff=0.5)
    return f"; did you mean {folded[match[0]]!r}?" if match else ""


def convert(value: typing.Any, hint: typing.Any, name: str) -> typing.Any:
    """A value as its field's type: whole numbers become floats, lists tuples, tables dataclasses, "none" None.

    Args:
        value: As it came from TOML or from Python.
        hint: The field's type.
        name: Full name of the field, for messages.
    Raises:
        SceneError: The value is of another type, or a number is not finite.
    """
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        if isinstance(value, dict):
            value = hint(**{key: item for key, item in value.items() if known_key(key, hint, name)})
        if not isinstance(value, hint):
            raise SceneError(f"{name} = {value!r}: expected a table with {', '.join(field_types(hint))}")
        for key, inner in field_types(hint).items():
            object.__setattr__(value, key, convert(getattr(value, key), inner, f"{name}.{key}"))
        return value
    if isinstance(hint, types.UnionType):
        options = hint.__args__
        if type(None) in options and (value is None or (isinstance(value, str) and value.lower() == "none")):
            return None
        plain = [option for option in options if option is not type(None)]
        if str in plain and isinstance(value, str):
            return value
        return convert(value, next(option for option in plain if option is not str or len(plain) == 1), name)
    if typing.get_origin(hint) is tuple:
        inner = typing.get_args(hint)
        repeated = len(inner) == 2 and inner[1] is Ellipsis
        if not isinstance(value, (list, tuple)) or (not repeated and len(value) != len(inner)):
            raise SceneError(f"{name} = {value!r}: expected a list" + ("" if repeated else f" of {len(inner)} values"))
        kinds = [inner[0]] * len(value) if repeated else inner
        if dataclasses.is_dataclass(inner[0]):
            return tuple(_item(value, index, inner[0], name) for index in range(len(value)))
        return tuple(convert(item, kind, name) for item, kind in zip(value, kinds, strict=True))
    if hint is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        if not math.isfinite(value):
            raise SceneError(f"{name} = {value}: expected a finite number")
        return float(value)
    # True is an int to Python, not to us.
    if type(value) is not hint:
        words = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}
        raise SceneError(f"{name} = {value!r}: expected {words[hint]}")
    return value


def _item(items: typing.Sequence[typing.Any], index: int, hint: typing.Any, name: str) -> typing.Any:
    with within(which(items, index, whats(name))):
        return convert(items[index], hint, name)


def which(items: typing.Sequence[typing.Any], index: int, what: str = "light") -> str:
    """Which of the lights or waypoints (`what`), tables or dataclasses, for messages: "light 2 of 4, 'green'"."""
    item = items[index]
    name = item.get("name") if isinstance(item, dict) else getattr(item, "name", None)
    return f"{what} {index + 1} of {len(items)}" + (f", {name!r}" if isinstance(name, str) else "")


def whats(name: str) -> str:
    """What the tables in a field are called."""
    return "waypoint" if name == "press.path" else "light"


def known_key(key: str, section: type, name: str) -> bool:
    """True, or a SceneError that names the nearest key of `section`; `name` is where it stood ("" for the top of a file)."""
    known = field_types(section)
    if key not in known:
        full = f"{name}.{key}" if name else key
        raise SceneError(f"unknown key {full!r}{nearest(key, known) or '; known are ' + ', '.join(known)}")
    return True


def share(text: str, name: str) -> float:
    """ "2%" or "0.02" as 0.02."""
    number, percent = text.strip().removesuffix("%"), text.strip().endswith("%")
    try:
        return convert(float(number) * (0.01 if percent else 1.0), float, name)
    except ValueError:
        raise SceneError(f'{name} = {text!r}: expected a share, such as 0.02 or "2%"') from None


def _bare(text: str) -> str:
    """A list as a scene file has it, without its brackets."""
    return text.strip().removeprefix("[").removesuffix("]")


def parse_text(text: str | list[str], hint: typing.Any, name: str) -> typing.Any:
    """What was typed as a value for a field of this type; `convert` checks it later. Several numbers for one are a list.

    Numbers that do not parse stay text, so that the check can name them.
    """
    if typing.get_origin(hint) is tuple:
        words = [text] if isinstance(text, str) else text
        inner = typing.get_args(hint)[0]
        if dataclasses.is_dataclass(inner):
            try:
                return tomllib.loads("value = " + " ".join(words))["value"]
            except tomllib.TOMLDecodeError as error:
                raise SceneError(f"{name}: expected a TOML list of tables ({error})") from None
        if len(words) == 1:
            words = [_bare(words[0])]
            words = words[0].replace(",", " ").split() if inner is float else words[0].replace(",", " ").replace("x", " ").split()
        return [parse_text(word, inner, name) for word in words]
    assert isinstance(text, str)
    kinds = hint.__args__ if isinstance(hint, types.UnionType) else (hint,)
    if bool in kinds and text.lower() in ("true", "false"):
        return text.lower() == "true"
    if float in kinds and "," in text:
        return [parse_text(word, float, name) for word in _bare(text).replace(",", " ").split()]
    for kind in (int, float):
        if kind in kinds:
            try:
                return kind(text)
            except ValueError:
                pass
    return text
