"""Mutants: copies of numerical Python source with a single fault each, found by the syntax tree."""

from __future__ import annotations

import ast
import math
import random
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

FACTORS = (2.0, 0.5, 1.2, 0.8)
# A power of ten as small as this guards a division or ends an iteration; twice it does the same.
GUARD = 1e-8
SIGNS: dict[type, ast.operator] = {ast.Add: ast.Sub(), ast.Sub: ast.Add()}
# The same with the boundary on the other side, and turned round.
COMPARISONS: dict[type, tuple[ast.cmpop, ast.cmpop]] = {
    ast.Lt: (ast.LtE(), ast.Gt()),
    ast.LtE: (ast.Lt(), ast.GtE()),
    ast.Gt: (ast.GtE(), ast.Lt()),
    ast.GtE: (ast.Gt(), ast.LtE()),
}
# Calls whose first two arguments may be exchanged, or in which an exchange is a slip of types.
SYMMETRIC = {
    *("add", "allclose", "array_equal", "hypot", "inner", "isclose", "logical_and", "logical_or"),
    *("max", "maximum", "min", "minimum", "multiply"),
    *("cast", "getattr", "hasattr", "isinstance", "issubclass", "setattr"),
}


@dataclass(frozen=True)
class Mutant:
    """The source at ``path`` with the bytes from ``start`` to ``end`` replaced by ``new``; its line
    ``before`` and ``after``."""

    path: str
    line: int
    kind: str
    old: str
    new: str
    start: int
    end: int
    before: str
    after: str

    def plant(self, root: Path) -> None:
        """Put the fault into the file under ``root``."""
        file = root / self.path
        source = file.read_bytes()
        if source[self.start : self.end].decode() != self.old:
            raise ValueError(f"{self.path} is not the source that the fault was drawn from")
        file.write_bytes(source[: self.start] + self.new.encode() + source[self.end :])


def draw(mutants: Iterable[Mutant], seed: int) -> Iterator[Mutant]:
    """Mutants at random, lines equally likely, kinds on a line equally likely, a line once."""
    lines: dict[tuple[str, int], dict[str, list[Mutant]]] = {}
    for each in mutants:
        lines.setdefault((each.path, each.line), {}).setdefault(each.kind, []).append(each)
    rng = random.Random(seed)
    for place in rng.sample(sorted(lines), len(lines)):
        yield rng.choice(rng.choice(list(lines[place].values())))


def mutants_of(root: Path, path: Path) -> list[Mutant]:
    """All mutants of one file."""
    finder = _Finder(path.relative_to(root).as_posix(), path.read_bytes())
    finder.visit(finder.tree)
    return finder.found


class _Finder(ast.NodeVisitor):
    """Collects mutants; what is not computed with, or only checked, printed or typed, is left."""

    def __init__(self, path: str, source: bytes) -> None:
        self.path, self.source = path, source
        self.tree = ast.parse(source)
        self.found: list[Mutant] = []
        self._lines = source.splitlines(keepends=True)
        self._starts = list(accumulate(map(len, self._lines), initial=0))

    def _replace(self, kind: str, node: ast.expr | ast.stmt, new: str) -> None:
        """Note the mutant with other code in the place of a node."""
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        start = self._starts[node.lineno - 1] + node.col_offset
        end = self._starts[node.end_lineno - 1] + node.end_col_offset
        old = self.source[start:end].decode()
        head = self._lines[node.lineno - 1][: node.col_offset].decode()
        tail = self._lines[node.end_lineno - 1][node.end_col_offset :].decode()
        before, after = (" ".join(f"{head}{code}{tail}".split()) for code in (old, new))
        if new != old:
            self.found.append(
                Mutant(self.path, node.lineno, kind, old, new, start, end, before, after)
            )

    # --- what is left alone ---

    def _leave(self, node: ast.AST) -> None:
        pass

    visit_Raise = visit_JoinedStr = visit_TypeAlias = visit_Import = visit_ImportFrom = _leave

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        """Neither annotations nor decorators."""
        for each in (*node.args.defaults, *filter(None, node.args.kw_defaults), *node.body):
            self.visit(each)

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        if not any(_name(base) == "Protocol" for base in node.bases):
            for each in node.body:
                self.visit(each)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_Assign(self, node: ast.Assign) -> None:
        if _name(node.targets[0]) != "__all__":
            self.generic_visit(node)

    def visit_If(self, node: ast.If) -> None:
        if _name(node.test) == "TYPE_CHECKING" or "__main__" in ast.dump(node.test):
            for each in node.orelse:
                self.visit(each)
        else:
            self.generic_visit(node)

    # --- operators ---

    def visit_Constant(self, node: ast.Constant) -> None:
        """A real number; whole ones that are computed with, see `visit_BinOp`."""
        value = node.value
        if not isinstance(value, float) or value == 0.0:
            return
        if not (value <= GUARD and math.log10(value) % 1.0 == 0.0):
            for factor in FACTORS:
                self._replace("factor", node, repr(float(f"{factor * value:.12g}")))

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.USub):
            self._replace("sign", node, ast.unparse(node.operand))
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        if type(node.op) in SIGNS and not _is_text(node.value):
            self._replace("sign", node, _changed(node, op=SIGNS[type(node.op)]))
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp, *, inside_product: bool = False) -> None:
        text = _is_text(node.left) or _is_text(node.right)
        product = isinstance(node.op, (ast.Mult, ast.Div, ast.MatMult))
        if type(node.op) in SIGNS and not text:
            self._replace("sign", node, _changed(node, op=SIGNS[type(node.op)]))
        elif product and not text and not inside_product:
            for factor in (2,) if _is_whole(node) else FACTORS:
                self._replace("factor", node, f"({factor} * ({ast.unparse(node)}))")
        for each in (node.left, node.right):
            if isinstance(node.op, ast.Pow) and each is node.right and _is_number(each):
                self._visit_exponent(each)
            elif isinstance(each, ast.Constant) and type(each.value) is int:
                self._replace("factor", each, str(2 * each.value))
            elif isinstance(each, ast.BinOp):
                self.visit_BinOp(each, inside_product=product)
            else:
                self.visit(each)

    def _visit_exponent(self, node: ast.expr) -> None:
        value = ast.literal_eval(node)
        step = 1 if isinstance(value, int) else 0.5 if value % 1.0 else 1.0
        others = {2: (3, 1), 3: (2, 4)}.get(value, (value + math.copysign(step, value),))
        for other in others:
            self._replace("exponent", node, repr(type(value)(other)))

    def visit_Subscript(self, node: ast.Subscript) -> None:
        self.visit(node.value)
        for index in node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]:
            self._visit_index(index)

    def _visit_index(self, node: ast.expr) -> None:
        if isinstance(node, ast.Slice):
            for bound in filter(None, (node.lower, node.upper, node.step)):
                self._visit_index(bound)
        elif _is_number(node):
            value = ast.literal_eval(node)
            for other in {0: (1,), 1: (0,), -1: (-2,)}.get(value, (value + 1, value - 1)):
                self._replace("index", node, str(other))
        else:
            self.visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        if _only_tells(node):
            return
        for i in range(len(node.args) - 1) if _name(node.func) not in SYMMETRIC else ():
            head, (one, two), tail = node.args[:i], node.args[i : i + 2], node.args[i + 2 :]
            known = ast.Starred not in (type(one), type(two)) and ast.dump(one) != ast.dump(two)
            if known and not (_is_text(one) or _is_text(two)):
                self._replace("arguments", node, _changed(node, args=[*head, two, one, *tail]))
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        operands = [node.left, *node.comparators]
        for i, operator in enumerate(node.ops):
            if type(operator) in COMPARISONS:
                boundary, turned = (
                    _changed(node, ops=[*node.ops[:i], other, *node.ops[i + 1 :]])
                    for other in COMPARISONS[type(operator)]
                )
                self._replace("comparison", node, turned)
                # a real number that is computed does not meet a decimal fraction
                if not any(map(_is_fraction, operands[i : i + 2])):
                    self._replace("comparison", node, boundary)
        self.generic_visit(node)


def _changed(node: ast.AST, **fields: object) -> str:
    """The code of a node with other fields."""
    return ast.unparse(type(node)(**{**dict(ast.iter_fields(node)), **fields}))


def _name(node: ast.expr) -> str:
    """The last word of a name, an attribute or a subscripted name."""
    if isinstance(node, ast.Subscript):
        node = node.value
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def _is_text(node: ast.expr) -> bool:
    if isinstance(node, (ast.JoinedStr, ast.List, ast.Tuple)):
        return True
    return isinstance(node, ast.Constant) and isinstance(node.value, (str, bytes))


def _is_number(node: ast.expr) -> bool:
    operand = node.operand if isinstance(node, ast.UnaryOp) else node
    return isinstance(operand, ast.Constant) and type(operand.value) in (int, float)


def _is_whole(node: ast.expr) -> bool:
    """Whether a product looks as if it counted: it has numbers, and all are whole ones."""
    numbers = [each.value for each in ast.walk(node) if isinstance(each, ast.Constant)]
    return bool(numbers) and all(type(each) is int for each in numbers)


def _is_fraction(node: ast.expr) -> bool:
    return _is_number(node) and ast.literal_eval(node) % 1.0 != 0.0


def _only_tells(node: ast.Call) -> bool:
    """Whether a call is of a logger, of `warnings` or of `print`."""
    return re.match(r"(log|logger|warnings|print)\b", ast.unparse(node.func)) is not None
