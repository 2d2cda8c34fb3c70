"""Errors form a small tree that a program can catch: every concrete error derives from one of its classes."""

import ast
import pickle
from pathlib import Path

import pytest

import ninedtact
from ninedtact import errors
from ninedtact.simulation.objects.mesh_objects import MeshMisplaced
from ninedtact_hardware.buildability import DesignNotBuildable, DesignRule

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


@pytest.mark.parametrize(
    "error",
    [
        errors.InputError(expected="one", got="two", remedy="drop one"),
        errors.InputError("expected one, got: two; drop one"),
    ],
)
def test_the_sentence_of_an_error_is_data(error: errors.InputError) -> None:
    assert (error.expected, error.got, error.remedy) == ("one", "two", "drop one")
    assert str(error).replace("got:", "got") == "expected one, got two; drop one"


def test_every_error_says_what_was_expected() -> None:
    """Its class takes the three parts, or a sentence that begins so; an interruption says what is kept instead."""
    other = []
    for path in PACKAGE.parents[3].glob("*/src/**/*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if not (isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and node.exc.args):
                continue
            if ast.unparse(node.exc.func) not in GROUPS:
                continue
            said = node.exc.args[0]
            first = said.values[0] if isinstance(said, ast.JoinedStr) else said
            if isinstance(first, ast.Constant) and not str(first.value).startswith(("expected ", "stopped by ")):
                other.append(f"{path.name}:{node.lineno}")
    assert not other


@pytest.mark.parametrize("name", sorted(GROUPS))
def test_groups_are_documented_and_derive_from_the_base(name: str) -> None:
    assert f"── {name} " in str(errors.__doc__)
    assert issubclass(getattr(errors, name), errors.NinedtactError)


@pytest.mark.parametrize(
    "error",
    [
        MeshMisplaced("expected a part of 1 mm, got 0.2 mm", "give unit in"),
        DesignNotBuildable([DesignRule("wall_too_thin", "a wall", 0.5, least=0.8)]),
        errors.InputError("expected one, got two"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_an_error_of_a_worker_arrives_as_it_was_raised(error: errors.NinedtactError) -> None:
    arrived = pickle.loads(pickle.dumps(error))
    assert (type(arrived), str(arrived), vars(arrived)) == (type(error), str(error), vars(error))
