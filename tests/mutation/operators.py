"""What a mutant is: one small change somewhere in the functions of a file, made on its syntax tree."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from types import CodeType
from typing import Any

SWAPS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.FloorDiv, ast.LShift: ast.RShift, ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.BitXor: ast.BitAnd,
}  # fmt: skip

BOUNDARY: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
}  # fmt: skip

OPPOSITE: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip

EXCHANGED = {"max": "min", "min": "max"}

SAID_ONLY = {"decorator_list", "returns", "annotation", "args", "type_params", "type_comment"}
"""Fields of functions that compute nothing."""

Function = (ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass(frozen=True)
class Place:
    """A node of a syntax tree, and where it hangs.

    Attributes
    ----------
    owner, field, index : object, str, int or None
        ``owner.field`` is the node, or the list that has it at `index`.
    node : AST
    function : str
        Qualified name of the outermost function around it.
    statement : stmt
    known : bool
        For statements: whether the names they assign had values before.
    """

    owner: Any
    field: str
    index: int | None
    node: Any
    function: str
    statement: ast.stmt
    known: bool

    def put(self, node: ast.AST) -> None:
        """Hang another node here."""
        if self.index is None:
            setattr(self.owner, self.field, node)
        else:
            getattr(self.owner, self.field)[self.index] = node


@dataclass(frozen=True)
class Mutant:
    """One change of a file.

    Attributes
    ----------
    number : int
        Its place among all mutants of the file, in the order of the text.
    operator : str
        Kind of change.
    before, after : str
        First line of the changed statement.
    """

    number: int
    operator: str
    before: str
    after: str
    tree: ast.Module
    place: Place
    new: ast.AST

    @property
    def function(self) -> str:
        """Qualified name of the changed function."""
        return self.place.function

    @property
    def line(self) -> int:
        """Line of the change."""
        return int(getattr(self.place.node, "lineno", self.place.statement.lineno))

    def codes(self, path: str) -> dict[str, CodeType]:
        """Compiled functions of the changed file that the change is in, by qualified name."""
        self.place.put(self.new)
        try:
            code = compile(self.tree, path, "exec")
        finally:
            self.place.put(self.place.node)
        found = {}
        left = [code]
        while left:
            for part in left.pop().co_consts:
                if isinstance(part, CodeType):
                    left.append(part)
                    if part.co_qualname == self.function:
                        found[part.co_qualname] = part
        return found


def mutants(source: str) -> list[Mutant]:
    """All mutants of a file, in the order of its text."""
    tree = ast.parse(source)
    out: list[Mutant] = []
    for place in list(_places(tree)):
        before = _head(place.statement)
        for operator, new in _changes(place):
            ast.fix_missing_locations(ast.copy_location(new, place.node))
            place.put(new)
            after = _head(new) if place.node is place.statement else _head(place.statement)
            place.put(place.node)
            out.append(Mutant(len(out), operator, before, after, tree, place, new))
    return out


def _head(statement: ast.stmt) -> str:
    return ast.unparse(statement).splitlines()[0]


def _places(tree: ast.Module) -> Iterator[Place]:
    """Every node inside functions, in the order of the text."""

    def outer(nodes: list[ast.stmt], prefix: str) -> Iterator[Place]:
        for node in nodes:
            if isinstance(node, Function):
                yield from body(node, prefix + node.name, set())
            elif isinstance(node, ast.ClassDef):
                yield from outer(node.body, f"{prefix}{node.name}.")

    def body(owner: Any, function: str, known: set[str]) -> Iterator[Place]:
        for field in ("body", "orelse", "finalbody"):
            for i, statement in enumerate(getattr(owner, field, ())):
                named = _assigned(statement)
                yield Place(owner, field, i, statement, function, statement, bool(named) and named <= known)
                yield from parts(statement, function, statement)
                if isinstance(statement, ast.For):
                    known |= {n.id for n in ast.walk(statement.target) if isinstance(n, ast.Name)}
                known |= named
                yield from body(statement, function, known)

    def parts(owner: Any, function: str, statement: ast.stmt) -> Iterator[Place]:
        for field, value in ast.iter_fields(owner):
            if field in SAID_ONLY and isinstance(owner, (*Function, ast.AnnAssign, ast.Lambda)):
                continue
            for i, node in enumerate(value) if isinstance(value, list) else [(None, value)]:
                if isinstance(node, ast.expr | ast.comprehension | ast.keyword):
                    yield Place(owner, field, i, node, function, statement, False)
                    yield from parts(node, function, statement)

    yield from outer(tree.body, "")


def _assigned(statement: ast.stmt) -> set[str]:
    targets = statement.targets if isinstance(statement, ast.Assign) else []
    return {n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}


def _changes(place: Place) -> Iterator[tuple[str, ast.AST]]:
    node = place.node
    if isinstance(node, ast.stmt):
        yield from _deleted(place)
    elif isinstance(node, ast.BinOp) and type(node.op) in SWAPS:
        yield "arithmetic", ast.BinOp(node.left, SWAPS[type(node.op)](), node.right)
    elif isinstance(node, ast.Compare):
        yield from _compared(node)
    elif isinstance(node, ast.BoolOp):
        yield "logic", ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
        for i in range(len(node.values)):
            rest = node.values[:i] + node.values[i + 1 :]
            yield "logic", rest[0] if len(rest) == 1 else ast.BoolOp(node.op, rest)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield "sign" if isinstance(node.op, ast.USub) else "logic", _copied(node.operand)
    elif isinstance(node, ast.Constant):
        yield from _constants(node.value)
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        yield from _called(node)
    elif isinstance(node, ast.Subscript):
        yield from _indexed(node)
    elif isinstance(node, ast.IfExp):
        yield "branch", ast.IfExp(node.test, node.orelse, node.body)
    if isinstance(node, ast.Name | ast.Call | ast.Attribute) and place.field == "test":
        yield "logic", ast.UnaryOp(ast.Not(), node)


def _copied(node: ast.expr) -> ast.expr:
    return ast.parse(ast.unparse(node), mode="eval").body


def _deleted(place: Place) -> Iterator[tuple[str, ast.AST]]:
    node = place.node
    if isinstance(node, ast.AugAssign):
        if type(node.op) in SWAPS:
            yield "arithmetic", ast.AugAssign(node.target, SWAPS[type(node.op)](), node.value)
        yield "accumulate", ast.Assign([node.target], node.value, lineno=node.lineno)
        yield "delete", ast.Pass()
    elif isinstance(node, ast.Break | ast.Continue) or _says_something(node):
        yield "delete", ast.Pass()
    elif isinstance(node, ast.Assign):
        if place.known or not _assigned(node):
            yield "delete", ast.Pass()
        if isinstance(node.value, ast.Tuple) and len(node.value.elts) == 2:
            yield "exchange", ast.Assign(node.targets, ast.Tuple(node.value.elts[::-1], ast.Load()))
    elif isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple) and len(node.value.elts) > 1:
        one, two, *rest = node.value.elts
        yield "exchange", ast.Return(ast.Tuple([two, one, *rest], ast.Load()))
    elif isinstance(node, ast.Return) and node.value is None:
        yield "delete", ast.Pass()


def _says_something(node: ast.stmt) -> bool:
    """Whether it is an expression, and not a docstring."""
    return isinstance(node, ast.Expr) and not isinstance(node.value, ast.Constant)


def _compared(node: ast.Compare) -> Iterator[tuple[str, ast.AST]]:
    for i, op in enumerate(node.ops):
        for kind, table in (("boundary", BOUNDARY), ("comparison", OPPOSITE)):
            if type(op) in table:
                ops = [*node.ops[:i], table[type(op)](), *node.ops[i + 1 :]]
                yield kind, ast.Compare(node.left, ops, node.comparators)


def _constants(value: object) -> Iterator[tuple[str, ast.AST]]:
    if isinstance(value, bool):
        yield "constant", ast.Constant(not value)
    elif isinstance(value, int):
        yield "constant", ast.Constant(value + 1)
        yield "constant", ast.Constant(value - 1) if value > 0 else ast.UnaryOp(ast.USub(), ast.Constant(1 - value))
    elif isinstance(value, float):
        if value == 0.0:
            yield "constant", ast.Constant(1.0)
        else:
            yield "sign", ast.UnaryOp(ast.USub(), ast.Constant(value))
            yield "constant", ast.Constant(2.0 * value)


def _called(node: ast.Call) -> Iterator[tuple[str, ast.AST]]:
    name = node.func.id  # type: ignore[attr-defined]
    if name in EXCHANGED:
        yield "exchange", ast.Call(ast.Name(EXCHANGED[name], ast.Load()), node.args, node.keywords)
        for argument in node.args if len(node.args) == 2 else ():
            yield "bound", argument
    elif name == "abs":
        yield "sign", node.args[0]
    elif name == "range":
        first = node.args[0] if len(node.args) > 1 else ast.Constant(0)
        last = node.args[1] if len(node.args) > 1 else node.args[0]
        one = ast.Constant(1)
        call = lambda a, b: ast.Call(node.func, [a, b, *node.args[2:]], [])  # noqa: E731
        yield "range", call(ast.BinOp(first, ast.Add(), one), last)
        yield "range", call(first, ast.BinOp(last, ast.Sub(), one))


def _indexed(node: ast.Subscript) -> Iterator[tuple[str, ast.AST]]:
    """Each index by a name or an expression moved by one, downwards: upwards mostly leaves the array."""
    entries = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
    for i, entry in enumerate(entries):
        if isinstance(entry, ast.Name | ast.BinOp | ast.Subscript | ast.Attribute):
            moved = [*entries]
            moved[i] = ast.BinOp(entry, ast.Sub(), ast.Constant(1))
            index = ast.Tuple(moved, ast.Load()) if isinstance(node.slice, ast.Tuple) else moved[0]
            yield "index", ast.Subscript(node.value, index, node.ctx)
