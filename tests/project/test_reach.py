"""Which tests can reach a planted fault: by imports, the nearest first."""

from reach import ROOT, importers, in_order


def test_files_from_which_imports_lead_to_a_fault_reach_it_nearest_first():
    names = ["studies/test_drop.py", "meshes/test_tip_shape.py", "solver/test_effects.py"]
    # the solver's test of effects comes to the fall by itself, a sweep by way of the interface
    found = in_order("solver/fall.py", ["studies/test_sweep.py", *names])
    assert found == ["solver/test_effects.py", "studies/test_drop.py", "studies/test_sweep.py"]


def test_importers_are_those_through_others_too():
    near = importers(ROOT / "solver" / "contact" / "friction.py")
    assert ROOT / "solver" / "batch.py" in near
    assert ROOT / "solver" / "bristle.py" not in near
