"""Settings as commented TOML, written from the structs that hold them.

A setting is explained in one place: the text below its field in the class. `settings_of` reads that
text out of the source of any msgspec struct, ours or another package's, beside the field's name,
type and default; `section` writes a section of a configuration from it. A struct whose source is
not there (made in an interactive session, say) is written without notes.

Prose begins with `# `, a default with `#name = `: take that one `#` away, and the line is TOML. A
setting that has no default and is given no value is written as `FILL_IN`, which the loader refuses
with the path of the field.
"""

from __future__ import annotations

import ast
import inspect
import itertools
import re
import textwrap
from collections.abc import Collection, Iterator, Mapping
from typing import Any, Literal

import msgspec
import msgspec.inspect as types

from tramstream.strict_toml import FILL_IN
from tramstream.toml_text import key_text, value_text

WIDTH = 100
"""Columns of the file."""
FREE_NAME = "name"
"""Stands where the user names a section, if no example does."""
_EVIDENT = re.compile(r"^(?:text|number|\d+ numbers)(?:, |$)")
"""What a value itself shows and nobody needs to be told."""
_UNBOUNDED = 1e9
"""A bound as large as this only keeps arithmetic finite; it tells nothing about the setting."""
_QUOTED = re.compile(r"`[^`\n]*`")
_NO_BREAK = "\0"
"""Stands for a blank at which no line may end."""
_Shape = Literal["one", "named", "list"]


class Setting(msgspec.Struct, frozen=True, kw_only=True):
    """One field of a struct of settings, as people read of it."""

    name: str
    """Its key in TOML."""
    words: str
    """What may be written, in words: `number, above 0`, `"lowpass" or "mean"`."""
    note: str
    """The text below the field in the class; empty if there is none."""
    required: bool
    default: Any
    """In plain values, as TOML has them; None if there is none."""
    section: type[msgspec.Struct] | None = None
    """The struct, if the setting is a section of its own."""
    shape: _Shape = "one"
    """One section, one for each name, or a list of them."""
    tag: tuple[str, Any] | None = None
    """Field and value by which msgspec tells the struct from others."""


class _Section(msgspec.Struct, frozen=True, kw_only=True):
    """What one table of the file is made of."""

    path: str
    settings: type[msgspec.Struct]
    values: Mapping[str, Any]
    live: bool
    note: str = ""
    """What the field says whose section this is; it takes the place of the struct's own text."""
    shape: _Shape = "one"
    tag: tuple[str, Any] | None = None


def section(
    name: str,
    settings: type[msgspec.Struct],
    values: Mapping[str, Any] | None = None,
    *,
    commented: bool = False,
) -> str:
    """Write a section of a configuration, and the sections within it.

    Parameters
    ----------
    name : str
        Of the section, dots and all: `gnss`, `simulators.ride`.
    settings : type
        The struct that the section becomes.
    values : mapping, optional
        What is written instead of the defaults, in plain values, sections within as mappings.
    commented : bool
        Whether the whole section is commented out.

    Returns
    -------
    text : str
        Each setting once with its note; a struct that comes again is not explained again.
    """
    made = _Section(path=name, settings=settings, values=values or {}, live=not commented)
    return "\n".join(_written(made, set())) + "\n"


def scalars(
    settings: type[msgspec.Struct],
    values: Mapping[str, Any] | None = None,
    *,
    without: Collection[str] = (),
) -> str:
    """Write those fields of a struct that are no sections, without a heading.

    Parameters
    ----------
    settings : type
    values : mapping, optional
        What is written instead of the defaults.
    without : collection of str
        Names of fields that are left out, for a file does not have them.
    """
    given = values or {}
    found = [
        each for each in settings_of(settings) if each.section is None and each.name not in without
    ]
    return "\n".join(line for each in found for line in _lines(each, given, True, True)) + "\n"


def settings_of(settings: type[msgspec.Struct]) -> list[Setting]:
    """The fields of a struct in their order, with what is said of them in its source."""
    info = types.type_info(settings)
    assert isinstance(info, types.StructType)
    notes = notes_of(settings)
    python_names = dict(
        zip(settings.__struct_encode_fields__, settings.__struct_fields__, strict=True)
    )
    return [
        _setting(field, notes.get(python_names[field.encode_name], "")) for field in info.fields
    ]


def notes_of(settings: type[msgspec.Struct]) -> dict[str, str]:
    """The texts below the fields of a class and its bases, by the fields' names."""
    found: dict[str, str] = {}
    for class_ in reversed(settings.__mro__):
        if issubclass(class_, msgspec.Struct) and class_ is not msgspec.Struct:
            found |= _own_notes(class_)
    return found


def _own_notes(class_: type) -> dict[str, str]:
    try:
        source = inspect.getsource(class_)
        tree = ast.parse(f"if True:\n{source}" if source[:1].isspace() else source)
    except (OSError, TypeError, SyntaxError):
        return {}
    body = next(node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)).body
    found = {}
    for field, text in itertools.pairwise(body):
        if (
            isinstance(field, ast.AnnAssign)
            and isinstance(field.target, ast.Name)
            and isinstance(text, ast.Expr)
            and isinstance(text.value, ast.Constant)
            and isinstance(text.value.value, str)
        ):
            found[field.target.id] = inspect.cleandoc(text.value.value)
    return found


def _setting(field: types.Field, note: str) -> Setting:
    default: Any = None
    if field.default is not msgspec.NODEFAULT:
        default = field.default
    elif field.default_factory is not msgspec.NODEFAULT:
        default = field.default_factory()
    structs, shape = _inner(field.type)
    chosen = next((each for each in structs if isinstance(default, each.cls)), None)
    inner = chosen or (structs[0] if structs else None)
    return Setting(
        name=field.encode_name,
        words=_words(field.type),
        note=note,
        required=field.required,
        default=msgspec.to_builtins(default),
        section=inner.cls if inner else None,
        shape=shape,
        tag=(inner.tag_field, inner.tag) if inner and inner.tag_field else None,
    )


def _inner(type_: types.Type) -> tuple[list[types.StructType], _Shape]:
    """The structs in `Gnss | None`, `dict[str, Wheel]` or `list[Wheel]`, and which these are."""
    type_ = _bare(type_)
    if isinstance(type_, types.StructType):
        return [type_], "one"
    if isinstance(type_, types.UnionType):
        found = [_inner(each) for each in type_.types]
        structs = [struct for each in found for struct in each[0]]
        return structs, next((shape for some, shape in found if some), "one")
    if isinstance(type_, types.DictType):
        return _inner(type_.value_type)[0], "named"
    if isinstance(type_, types.ListType | types.VarTupleType):
        return _inner(type_.item_type)[0], "list"
    return [], "one"


def _bare(type_: types.Type) -> types.Type:
    return _bare(type_.type) if isinstance(type_, types.Metadata) else type_


# What may be written, in words -------------------------------------------------------------------


def _words(type_: types.Type) -> str:
    type_ = _bare(type_)
    if isinstance(type_, types.IntType):
        return "whole number" + _bounds(type_)
    if isinstance(type_, types.FloatType):
        return "number" + _bounds(type_)
    if isinstance(type_, types.StrType):
        return "text"  # a pattern is the note's to explain; who misses it is shown it
    if isinstance(type_, types.BoolType):
        return "true or false"
    if isinstance(type_, types.LiteralType):
        return _either([value_text(value) for value in type_.values])
    if isinstance(type_, types.EnumType):
        return _either([value_text(each.value) for each in type_.cls])
    if isinstance(type_, types.UnionType):
        some = [each for each in type_.types if not isinstance(each, types.NoneType)]
        return _either([_words(each) for each in some])
    if isinstance(type_, types.TupleType):
        kinds = [_words(each) for each in type_.item_types]
        if len(set(kinds)) == 1:
            return _several(kinds[0], f"{len(kinds)} ")
        return f"list: {'; '.join(kinds)}"
    if isinstance(type_, types.CollectionType):
        return _several(_words(type_.item_type), "list of ")
    if isinstance(type_, types.DictType):
        return _several(_words(type_.value_type), "table of ")
    if isinstance(type_, types.StructType):
        return "section"
    return type(type_).__name__.removesuffix("Type").lower()


def _bounds(type_: types.IntType | types.FloatType) -> str:
    least, above, most, below = (
        None if bound is None or abs(bound) >= _UNBOUNDED else bound
        for bound in (type_.ge, type_.gt, type_.le, type_.lt)
    )
    if least is not None and most is not None:
        return f", {least:.15g} to {most:.15g}"
    parts = [
        f", above {above:.15g}" if above is not None else "",
        f", {least:.15g} or more" if least is not None else "",
        f", below {below:.15g}" if below is not None else "",
        f", {most:.15g} at most" if most is not None else "",
    ]
    return "".join(parts)


def _several(words: str, many: str) -> str:
    """Several of one kind: `3 numbers, each above 0`, `list of texts`."""
    kind, comma, bounds = words.partition(", ")
    if not re.fullmatch(r"text|number|whole number", kind):
        return f"{many}values, each {words}"
    return f"{many}{kind}s{f'{comma}each {bounds}' if bounds else ''}"


def _either(choices: list[str]) -> str:
    return " or ".join(part for part in (", ".join(choices[:-1]), choices[-1]) if part)


# Text --------------------------------------------------------------------------------------------


def _written(made: _Section, told: set[type]) -> Iterator[str]:
    """The lines of a section and of those within it; `told` holds the structs explained already."""
    mark = "" if made.live else "#"
    explain = made.settings not in told
    told.add(made.settings)
    if made.note:
        yield from _prose(made.note)
    elif explain:
        yield from _prose(made.settings.__dict__.get("__doc__") or "")
    yield mark + (f"[[{made.path}]]" if made.shape == "list" else f"[{made.path}]")
    if made.tag:
        yield f"{mark}{key_text(made.tag[0])} = {value_text(made.tag[1])}"
    found = settings_of(made.settings)
    for setting in found:
        if setting.section is None:
            yield from _lines(setting, made.values, made.live, explain)
    for setting in found:
        if setting.section is not None:
            yield ""
            yield from _within(setting, made, told)


def _within(setting: Setting, outer: _Section, told: set[type]) -> Iterator[str]:
    """The sections that a setting of `outer` stands for; commented out if they may be absent."""
    assert setting.section is not None
    given = outer.values.get(setting.name, setting.default)
    path = f"{outer.path}.{key_text(setting.name)}"
    named = setting.name in outer.values and (setting.shape == "one" or bool(given))
    live = outer.live and (setting.required or named or bool(setting.default))
    each: list[tuple[str, Mapping[str, Any]]]
    if setting.shape == "named":
        each = [(f"{path}.{key_text(key)}", one) for key, one in (given or {FREE_NAME: {}}).items()]
    elif setting.shape == "list":
        each = [(path, one) for one in given or [{}]]
    else:
        each = [(path, given or {})]
    for index, (name, values) in enumerate(each):
        if index:
            yield ""
        made = _Section(
            path=name,
            settings=setting.section,
            values=values,
            live=live,
            note=setting.note if index == 0 else "",
            shape=setting.shape,
            tag=setting.tag,
        )
        yield from _written(made, told)


def _lines(setting: Setting, values: Mapping[str, Any], live: bool, explain: bool) -> Iterator[str]:
    """A setting with its note above it, and beside it what may be written."""
    value = values.get(setting.name, setting.default)
    if explain:
        yield from _prose(setting.note)
    live = live and (setting.required or value != setting.default)
    shown = value_text(FILL_IN if value is None else value)
    line = f"{'' if live else '#'}{key_text(setting.name)} = {shown}"
    words = setting.words if value is None else _EVIDENT.sub("", setting.words, count=1)
    if not words or not explain:
        yield line
    elif len(line) + len(words) + 4 <= WIDTH:
        yield f"{line}  # {words}"
    else:
        yield from _prose(f"{words[0].upper()}{words[1:]}.")
        yield line


def _prose(text: str) -> Iterator[str]:
    """Text as comments, paragraph by paragraph."""
    for index, paragraph in enumerate(inspect.cleandoc(text).split("\n\n") if text else ()):
        if index:
            yield "#"
        whole = _QUOTED.sub(lambda code: code[0].replace(" ", _NO_BREAK), paragraph)
        for line in textwrap.wrap(
            whole,
            WIDTH,
            initial_indent="# ",
            subsequent_indent="# ",
            break_long_words=False,
            break_on_hyphens=False,
        ):
            yield line.replace(_NO_BREAK, " ")
