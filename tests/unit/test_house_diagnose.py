"""The house of the diagnosis: numbers that decide stand in one place with their words, mechanisms say all about themselves."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.diagnose.mechanisms import MECHANISMS
from pipeline.diagnose.rules import list_rules

PACKAGE = Path(__file__).resolve().parents[2] / "pipeline" / "diagnose"
MODULES = sorted(PACKAGE.rglob("*.py"))
MOST_LINES_OF_ALGORITHM = 400


def holds_number(node: ast.expr) -> bool:
    """Whether an expression is made of numbers."""
    match node:
        case ast.Constant(value=value):
            return isinstance(value, int | float) and not isinstance(value, bool)
        case ast.UnaryOp(operand=one):
            return holds_number(one)
        case ast.BinOp(left=left, right=right):
            return holds_number(left) or holds_number(right)
        case ast.Tuple(elts=many) | ast.List(elts=many) | ast.Set(elts=many) | ast.Call(args=many):
            return any(holds_number(one) for one in many)
        case ast.Dict(values=many):
            return any(holds_number(one) for one in many)
    return False


def find_bare_constants(source: str) -> Iterator[str]:
    """Constants of a module that hold numbers and have no word: neither a docstring after them nor a comment."""
    lines, body = source.splitlines(), ast.parse(source).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None or not holds_number(node.value):
            continue
        is_told = (
            isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and isinstance(after.value.value, str)
        )
        above = lines[node.lineno - 2].lstrip() if node.lineno > 1 else ""
        if not (is_told or "#" in lines[node.lineno - 1] or above.startswith("#")):
            yield f"line {node.lineno}: {ast.unparse(node)[:60]}"


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("_A = 3\n", 1),
        ("_A = 3\n'''Sweeps.'''\n", 0),
        ("_A = 3  # sweeps\n", 0),
        ("# sweeps\n_A = 3\n", 0),
        ("_A: tuple[float, ...] = (1.0, -2.0)\n", 1),
        ("_A = np.log(20.0)\n", 1),
        ("_A = 'words'\n_B = True\n", 0),
    ],
)
def test_a_constant_without_a_word_is_seen(source: str, found: int) -> None:
    assert len(list(find_bare_constants(source))) == found


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_every_numeric_constant_has_a_word(path: Path) -> None:
    assert list(find_bare_constants(path.read_text(encoding="utf-8"))) == []


def test_every_rule_has_meaning_unit_and_calibration() -> None:
    rules = list(list_rules())
    assert len(rules) > 100
    assert len({r.name for r in rules}) == len(rules)
    for rule in rules:
        assert all((rule.meaning, rule.unit, rule.calibration)), rule.name


def test_no_mechanism_is_told_from_others_by_its_name() -> None:
    """What is special about a mechanism stands in its object: no module of the diagnosis beside the list names one."""
    for path in MODULES:
        if path.parent.name == "mechanisms":
            continue
        texts = {
            node.value
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Constant) and isinstance(node.value, str)
        }
        assert not texts & MECHANISMS.keys(), path


def test_the_algorithm_is_one_page_to_read() -> None:
    assert len((PACKAGE / "diagnosis.py").read_text(encoding="utf-8").splitlines()) <= MOST_LINES_OF_ALGORITHM
