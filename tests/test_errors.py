"""Errors form a small tree that a program can catch: every concrete error derives from one of its classes."""

import ast
from pathlib import Path

import pytest

import ninedtact
from ninedtact import errors

PACKAGE = Path(ninedtact.__file__).parent
GROUPS = {name for name, kind in vars(errors).items() if isinstance(kind, type) and kind is not errors.NinedtactError}


def test_every_error_belongs_to_a_group() -> None:
    alone = [
        f"{path.relative_to(PACKAGE)}: {node.name}"
        for path in PACKAGE.rglob("*.py")
        if path != PACKAGE / "errors.py"
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef) and "NinedtactError" in map(ast.unparse, node.bases)
    ]
    assert not alone, "derive these from a class of ninedtact.errors"


@pytest.mark.parametrize("name", sorted(GROUPS))
def test_groups_are_documented_and_derive_from_the_base(name: str) -> None:
    assert f"── {name} " in str(errors.__doc__)
    assert issubclass(getattr(errors, name), errors.NinedtactError)
