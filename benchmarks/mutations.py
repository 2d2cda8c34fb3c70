"""Single-operator mutations of Python source: where they are possible, what they change, and what is left alone.

    comparison   < and <=, > and >= are exchanged, or turned round (< and >=); ==, in and is are negated
    arithmetic   + and -, * and /, // and /, & and |; ** becomes *, % becomes //; a sign is dropped
    logic        and and or are exchanged; not is dropped; True and False are exchanged
    constant     an integer grows by one, a fraction by half; 0.0 becomes 1.0
    extreme      min and max, minimum and maximum, any and all, floor and ceil, argmin and argmax are exchanged
    exit         an `if` whose body only leaves (return, continue, break, raise) never leaves; a condition is negated

Left alone by rule, because no behaviour depends on it: docstrings and all text, annotations and type aliases, decorators, errors
and messages that are raised or logged, `__slots__`, `__all__`, asserts, code for type checkers, sums with zero times an array,
tiny constants that only keep a divisor from being zero, and keyword arguments like `dtype` or `zip(…, strict=True)`, which is an
assertion.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
}
_OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Div,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
_EXTREMES = {"min": "max", "minimum": "maximum", "any": "all", "floor": "ceil", "argmin": "argmax", "nanmin": "nanmax"}
_EXTREMES |= {new: old for old, new in _EXTREMES.items()}
_MESSAGES = {"warn", "warning", "info", "debug", "error", "exception", "log", "print", "write", "tqdm"}
_SILENT_KEYWORDS = {
    "dtype",
    "copy",
    "slots",
    "frozen",
    "daemon",
    "encoding",
    "repr",
    "compare",
    "init",
    "maxsize",
    "stacklevel",
    "strict",
}
_GUARD = 1e-6
"""Constants up to this one only keep a divisor or a tolerance from being zero."""
_LEAVING = (ast.Return, ast.Continue, ast.Break, ast.Raise)


@dataclass(frozen=True)
class Mutation:
    """One changed place of one file."""

    path: str
    """Relative to the folder of the sources."""
    line: int
    lines: tuple[int, ...]
    """Lines of the changed expression, then those of its whole statement: tests that execute one of them may notice."""
    at_import: bool
    """Whether it runs when the module is imported, and not in a function."""
    start: int
    end: int
    """Bytes of the file that are replaced."""
    original: str
    mutated: str
    source_line: str

    @property
    def key(self) -> tuple[str, str, str]:
        """Path, source line and what it becomes: the same after lines were inserted above."""
        return self.path, self.source_line, self.mutated

    def apply(self, source: bytes) -> bytes:
        """Return the mutated file."""
        return source[: self.start] + self.mutated.encode() + source[self.end :]


def find_mutations(path: Path, root: Path) -> list[Mutation]:
    """Return all mutations of one file, in the order of its lines."""
    source = path.read_bytes()
    return list(_MutationFinder(source, str(path.relative_to(root))).find())


class _MutationFinder:
    """The walk through one file."""

    def __init__(self, source: bytes, path: str) -> None:
        self._source, self._path = source, path
        self._tree = ast.parse(source)
        self._line_starts = [0]
        for line in source.splitlines(keepends=True):
            self._line_starts.append(self._line_starts[-1] + len(line))

    def find(self) -> Iterator[Mutation]:
        """Yield the mutations of all statements."""
        yield from self._in_statements(self._tree.body, at_import=True)

    def _in_statements(self, statements: list[ast.stmt], at_import: bool) -> Iterator[Mutation]:
        for statement in statements:
            yield from self._in_statement(statement, at_import)

    def _in_statement(self, statement: ast.stmt, at_import: bool) -> Iterator[Mutation]:
        """Yield the mutations of a statement and, after those of its head, of the statements in it."""
        if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef):
            defaults = [*statement.args.defaults, *filter(None, statement.args.kw_defaults)]
            yield from self._in_expressions(defaults, statement, True)
            yield from self._in_statements(statement.body, at_import=False)
            return
        if _is_left_alone(statement, at_import):
            return
        yield from self._in_expressions(_head(statement), statement, at_import)
        if isinstance(statement, ast.If | ast.While):
            yield from self._conditions(statement, at_import)
        if isinstance(statement, ast.AugAssign) and type(statement.op) in _OPERATORS:
            new = ast.AugAssign(statement.target, _OPERATORS[type(statement.op)](), statement.value)
            yield self._mutation(statement, new, statement, at_import, bracketed=False)
        for part in ("body", "orelse", "finalbody"):
            yield from self._in_statements(getattr(statement, part, []), at_import)
        for handler in getattr(statement, "handlers", []):
            yield from self._in_statements(handler.body, at_import)
        for case in getattr(statement, "cases", []):
            yield from self._in_statements(case.body, at_import)

    def _conditions(self, statement: ast.If | ast.While, at_import: bool) -> Iterator[Mutation]:
        """Yield the condition negated and, where its body only leaves, never true."""
        if isinstance(statement, ast.If) and len(statement.body) == 1 and isinstance(statement.body[0], _LEAVING):
            yield self._mutation(statement.test, ast.Constant(False), statement, at_import)
        elif not isinstance(statement.test, ast.Compare | ast.Constant):
            yield self._mutation(statement.test, ast.UnaryOp(ast.Not(), statement.test), statement, at_import)

    def _in_expressions(self, expressions: list[ast.expr], statement: ast.stmt, at_import: bool) -> Iterator[Mutation]:
        for expression in expressions:
            if _is_message(expression):
                continue
            yield from (
                self._mutation(expression, new, statement, at_import) for new in _single_operator_changes(expression)
            )
            yield from self._in_expressions(_children(expression), statement, at_import)

    def _mutation(
        self, old: ast.expr | ast.stmt, new: ast.AST, statement: ast.stmt, at_import: bool, bracketed: bool = True
    ) -> Mutation:
        start = self._line_starts[old.lineno - 1] + old.col_offset
        end = self._line_starts[(old.end_lineno or old.lineno) - 1] + (old.end_col_offset or 0)
        text = ast.unparse(ast.fix_missing_locations(new))
        simple = isinstance(new, ast.Constant | ast.Call | ast.Name) or not bracketed
        first = self._source[self._line_starts[old.lineno - 1] : self._line_starts[old.lineno]]
        return Mutation(
            path=self._path,
            line=old.lineno,
            lines=(*_line_range(old), *_head_lines(statement)),
            at_import=at_import,
            start=start,
            end=end,
            original=" ".join(self._source[start:end].decode().split()),
            mutated=text if simple else f"({text})",
            source_line=first.decode().strip(),
        )


def _single_operator_changes(node: ast.expr) -> Iterator[ast.expr]:
    """Yield an expression with one operator, constant or function exchanged."""
    match node:
        case ast.Compare(left, ops, comparators):
            for place, op in enumerate(ops):
                for new in _COMPARISONS[type(op)]:
                    yield ast.Compare(left, [*ops[:place], new(), *ops[place + 1 :]], comparators)
        case ast.BinOp(left, op, right) if type(op) in _OPERATORS and not _is_neutral(left) and not _is_neutral(right):
            yield ast.BinOp(left, _OPERATORS[type(op)](), right)
        case ast.UnaryOp(ast.USub() | ast.Not(), operand):
            yield operand
        case ast.BoolOp(op, values):
            yield ast.BoolOp(ast.Or() if isinstance(op, ast.And) else ast.And(), values)
        case ast.Call(ast.Name(name), arguments, keywords) if name in _EXTREMES:
            yield ast.Call(ast.Name(_EXTREMES[name]), arguments, keywords)
        case ast.Call(ast.Attribute(value, name), arguments, keywords) if name in _EXTREMES:
            yield ast.Call(ast.Attribute(value, _EXTREMES[name]), arguments, keywords)
        case ast.Constant(bool() | int() | float()) if isinstance(node.value, int) or not 0 < node.value <= _GUARD:
            yield ast.Constant(_changed_constant(node.value))


def _changed_constant(value: bool | int | float) -> bool | int | float:
    """Return the other truth value, the next integer, or half as much again."""
    if isinstance(value, bool):
        return not value
    return value + 1 if isinstance(value, int) else value * 1.5 or 1.0


def _children(node: ast.expr) -> list[ast.expr]:
    """Return the expressions in an expression that a mutation may change."""
    if isinstance(node, ast.JoinedStr):
        return []
    if isinstance(node, ast.UnaryOp) and isinstance(node.operand, ast.Constant):
        return []  # the sign of a constant is one change, its value another one of the same place
    if isinstance(node, ast.Call):
        kept = [keyword.value for keyword in node.keywords if keyword.arg not in _SILENT_KEYWORDS]
        return [node.func, *node.args, *kept]
    if isinstance(node, ast.Lambda):
        return [node.body]
    children = list(ast.iter_child_nodes(node))
    for comprehension in (child for child in children if isinstance(child, ast.comprehension)):
        children += [comprehension.iter, *comprehension.ifs]
    return [child for child in children if isinstance(child, ast.expr)]


def _head(statement: ast.stmt) -> list[ast.expr]:
    """Return the expressions of a statement, without its annotation, targets' names and the statements in it."""
    if isinstance(statement, ast.AnnAssign):
        return [statement.value] if statement.value else []
    if isinstance(statement, ast.ClassDef):
        return []
    if isinstance(statement, ast.With | ast.AsyncWith):
        return [item.context_expr for item in statement.items]
    return [child for child in ast.iter_child_nodes(statement) if isinstance(child, ast.expr)]


def _is_left_alone(statement: ast.stmt, at_import: bool) -> bool:
    """Return whether no mutation of the head of this statement can change behaviour that counts."""
    match statement:
        case ast.Raise() | ast.Assert() | ast.Import() | ast.ImportFrom() | ast.Expr(ast.Constant()):
            return True
        case ast.Assign([ast.Name(name)]) if name in ("__slots__", "__all__"):
            return True
        case ast.Assign(_, ast.Subscript() | ast.BinOp(_, ast.BitOr(), _)) if at_import:
            return True  # a type alias
        case ast.If(ast.Name("TYPE_CHECKING")):
            return True
    return False


def _is_message(node: ast.expr) -> bool:
    """Return whether an expression only builds or sends text for a person, or an annotation."""
    if isinstance(node, ast.Call):
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        return (
            name in _MESSAGES or name in ("TypeVar", "NewType", "Meta", "cast") or name.endswith(("Error", "Warning"))
        )
    return isinstance(node, ast.Subscript) and getattr(node.value, "id", "") in (
        "Annotated",
        "Literal",
        "tuple",
        "dict",
    )


def _is_neutral(node: ast.expr) -> bool:
    """Return whether an operand is text, of which only a person takes notice, or zero times an array, which only has its shape."""
    match node:
        case ast.BinOp(ast.Constant(0), ast.Mult(), _):
            return True
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str | bytes))


def _line_range(node: ast.expr | ast.stmt) -> range:
    return range(node.lineno, (node.end_lineno or node.lineno) + 1)


def _head_lines(statement: ast.stmt) -> range:
    """Return the lines of a statement without the statements in it."""
    body = getattr(statement, "body", None)
    if body and isinstance(body, list):
        return range(statement.lineno, max(body[0].lineno, statement.lineno + 1))
    return _line_range(statement)
