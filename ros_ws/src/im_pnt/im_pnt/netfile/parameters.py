"""Parameters of a net file: values that the cell gives, so that one net serves every cell.

Packages above im_pnt give the values, by entry points ``im_pnt.parameters``.
"""

from collections.abc import Mapping
from dataclasses import replace

from im_core.errors import nearest, quoted_text
from im_core.plugins import extensions
from im_core.text.yamltext import Value, find, mapping
from im_pnt.errors import MissingPartsError
from im_pnt.netfile.schema.net import FragmentFile
from im_pnt.netfile.schema.templates import Parameter
from im_pnt.netfile.substitution import filled
from im_pnt.netfile.text import checked, complaint_at, read_data


def with_parameters(root: Value) -> tuple[Value, Mapping[str, Parameter]]:
    """Fill in the parameters of a file; those in its templates are filled in the copies.

    Returns:
        The file, and the values by name.

    Raises:
        NetFileError: A parameter has no value, or an expression none.
        MissingPartsError: There is less of one than the file needs.
    """
    declared = read_data(root).get("parameters")
    if declared is None:
        return root, {}
    part = {"parameters": declared}
    needed = checked(root, part, FragmentFile, FragmentFile.model_validate).parameters
    known: dict[str, Parameter] = {}
    for values in extensions("im_pnt.parameters"):
        known.update(values())
    for name, count in needed.items():
        if name not in known:
            sentence = f"nobody gives the parameter {quoted_text(name)}{nearest(name, known)}"
            raise complaint_at(root, ("parameters",), sentence)
        there = known[name]
        if isinstance(there, list) and len(there) < count:
            place = find(root, ("parameters",)).value
            sentence = f"it needs {count} of the {name} of the cell, which has {len(there)}"
            raise MissingPartsError(place.file, place.line, sentence, place.column, parameter=name)
    given = {name: known[name] for name in needed}
    pairs = []
    for key, value in root.pairs:
        if key.text == "templates":
            templates = ((name, replace(each, pairs=_arguments(each, given))) for name, each in value.pairs)
            value = mapping(templates, value)
        elif key.text != "parameters":
            value = filled((key.text,), value, given, value.note)
        pairs.append((key, value))
    return replace(root, pairs=tuple(pairs)), given


def _arguments(template: Value, given: Mapping[str, Parameter]) -> tuple[tuple[Value, Value], ...]:
    """Return the parts of a template, with the parameters of the file in its arguments."""
    parts = template.pairs
    return tuple((k, filled((k.text,), v, given, v.note) if k.text == "arguments" else v) for k, v in parts)
