"""The scene file's page, from the pydantic models that validate it."""

from __future__ import annotations

import inspect
from dataclasses import astuple
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from fem_snh.scenes import _bones, schema
from fem_snh.tables import shapes
from fem_snh.tables.validation import Expect
from fem_snh.terms import rigid
from generated.table import table

#: The tables of a scene file, in the order of the page, each with the model that validates it.
TABLES = (
    ("Top-level keys", schema.Scene),
    ("[material], [[material]]", schema.MaterialChoice),
    ("[[hold]]", schema.Hold),
    ("[[move]]", schema.Move),
    ("[[symmetry]]", schema.Symmetry),
    ("[[bone]]", schema.BoneChoice),
    ("motion, of a skeleton", _bones.SkeletonMotion),
    ("[rig]", schema.Rig),
    ("noise", _bones.NoiseChoice),
    ("rotate", schema.Rotate),
    ("[[traction]]", schema.Traction),
    ("[gravity]", schema.Gravity),
    ("[[pressure]]", schema.Pressure),
    ("[[spring]]", schema.Spring),
    ("[[rigid]]", schema.Rigid),
    ("joint", rigid.RigidJoint),
    ("spring, of a rigid part", rigid.RigidSpring),
    ("[[contact]]", schema.Contact),
    ("[self_contact]", schema.SelfContact),
    ("[[cavity]]", schema.Cavity),
    ("[[obstacle]]", schema.Obstacle),
    ("shape", shapes.ShapeChoice),
    ("plane", shapes.PlaneShape),
    ("sphere", shapes.SphereShape),
    ("cylinder", shapes.CylinderShape),
    ("capsule", shapes.CapsuleShape),
    ("box", shapes.BoxShape),
    ("smooth_union", shapes.SmoothUnionShape),
    ("[[table]]", schema.Amplitude),
    ("[time]", schema.Time),
    ("damping", schema.Damping),
    ("[start]", schema.Start),
    ("[[probe]]", schema.Probe),
    ("[modes]", schema.Modes),
    ("[accuracy]", schema.Accuracy),
    ("mesh, of a built-in geometry", schema.Geometry),
    ("mesh, of a lattice", schema.Lattice),
    ("mesh, of tetrahedra", schema.Tetrahedra),
)


def markdown() -> str:
    """Return a section for each table of a scene file: what it is, and its keys."""
    parts = []
    for title, model in TABLES:
        summary = (inspect.getdoc(model) or "").partition("\n\n")[0]
        rows = [(f"`{key}`", *_row(model, key, f)) for key, f in model.model_fields.items()]
        head = ("key", "accepts", "default", "meaning")
        parts += [f"## {title}", " ".join(summary.split()), table(head, rows)]
    return "\n\n".join(parts)


def _row(model: type[BaseModel], key: str, field: FieldInfo) -> tuple[str, str, str]:
    named = (
        model is schema.Scene and key == "name"
    )  # the only key that a file gives by its own name
    default = "the file's name" if named else _default(field)
    return _accepted(key, field), default, field.description or ""


def _accepted(key: str, field: FieldInfo) -> str:
    """Return what error messages say that a key accepts, else the kind of its values."""
    from fem_snh import choices
    from fem_snh.assembly.elements import ELEMENTS

    words = {
        "element": ELEMENTS,
        "hessian": choices.HESSIANS,
        "globalization": getattr(choices, "GLOBALIZATIONS", ()),
        "assembly": choices.ASSEMBLIES,
        "predictor": choices.PREDICTORS,
    }
    if key in words:
        return "one of " + ", ".join(f"`{word}`" for word in words[key])
    if found := _expected([*field.metadata, field.annotation]):
        return found
    return _models(field.annotation)


def _expected(parts: list[Any]) -> str:
    """Return the text of the first `Expect` in a nested annotation."""
    for part in parts:
        if isinstance(part, Expect):
            return str(astuple(part)[0])
        if found := _expected([*get_args(part), *getattr(part, "__metadata__", ())]):
            return found
    return ""


def _models(kind: Any) -> str:
    """Return "a table" or "a list of tables" for an annotation that names a model."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return "a table"
    if getattr(kind, "__origin__", None) is list:
        return "a list of tables"
    return next((found for part in get_args(kind) if (found := _models(part))), "")


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    return "none" if value is None or value in ([], {}, ()) else f"`{_toml(value)}`"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple | list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return f'"{value}"' if isinstance(value, str) else str(value)
