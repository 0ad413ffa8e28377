"""Which tests can reach a planted fault: by the statement, by imports, by what is compiled."""

from mutants import Mutant
from reach import ROOT, Clean, importers, in_order, is_compiled, statement_lines

SOURCE = """\
LIMIT = 2.0


class Body:
    size = 3.0

    def grown(self, by=1.0):
        if by > LIMIT:
            return (
                self.size
                + by
            )
        for each in range(
            3
        ):
            by += each
        return by
"""


def test_a_fault_is_reached_by_what_runs_its_statement(tmp_path):
    path = tmp_path / "body.py"
    path.write_text(SOURCE)
    expected = {1: None, 5: None, 7: None, 8: (8,), 11: (9, 10, 11, 12)}
    expected |= {13: (13, 14, 15), 16: (16,)}
    for line, lines in expected.items():
        found = statement_lines(path, line)
        assert (found and tuple(found)) == lines


def fault_at(path, words):
    lines = (ROOT / path).read_text().splitlines()
    line = next(number for number, text in enumerate(lines, 1) if words in text)
    return Mutant(path, line, "sign", "", "", 0, 0, "", ""), line


def clean(lines, seconds=1.0):
    return Clean("", "", {"one": seconds, "other": seconds}, [], lines)


def test_only_tests_that_execute_a_python_line_are_run_near_and_quick_ones_first():
    fault, line = fault_at("solver/time/scheme.py", "return ")
    runs = {
        "studies/test_drop.py": clean({fault.path: {str(line): [1]}}, seconds=3.0),
        "solver/test_time.py": clean({fault.path: {str(line): [-1]}}),
        "solver/test_rigid.py": clean({fault.path: {str(line + 1000): [0]}}),
    }
    names, first = in_order(fault, runs)
    assert names == ["solver/test_time.py", "studies/test_drop.py"]
    assert first == {"one", "other"}


def test_compiled_lines_are_reached_from_files_that_import_them():
    """Directly, or through others that are compiled: the march of modes calls these laws."""
    fault, _ = fault_at("solver/contact/friction.py", "@inlined")
    assert is_compiled(ROOT / "solver" / "contact" / "friction.py")
    assert not is_compiled(ROOT / "solver" / "bristle.py")
    near = importers(ROOT / fault.path, within=is_compiled)
    assert ROOT / "solver" / "batch.py" in near
    assert ROOT / "solver" / "bristle.py" not in near
    runs = {
        "solver/test_batch.py": clean({"solver/batch.py": {"1": [0]}}),
        "meshes/test_geometry.py": clean({"meshes/geometry.py": {"1": [0]}}),
    }
    assert in_order(fault, runs) == (["solver/test_batch.py"], set())
