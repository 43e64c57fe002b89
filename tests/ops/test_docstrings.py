"""What every borrower asks of a number of neighbours: does it count the point itself?"""

import inspect
import re

import pytest

import cablejax.ops

NUMBERS = ("k", "removal_k", "capacity", "max_neighbors")


def asked() -> list[tuple[str, str]]:
    """Public kernels with their parameters that are numbers of neighbours."""
    found = []
    for name in cablejax.ops.__all__:
        function = getattr(cablejax.ops, name)
        if not inspect.isclass(function):
            found += [(name, each) for each in NUMBERS if each in inspect.signature(function).parameters]
    # The capacities of lists and grids count edges and voxels.
    other = {
        ("edge_list", "capacity"),
        ("knn_graph", "capacity"),
        ("radius_graph", "capacity"),
        ("voxel_downsample", "capacity"),
    }
    # A ball's centre is no point of the cloud, and counts if one lies there.
    return sorted(set(found) - other - {("ball_query", "capacity")})


@pytest.mark.parametrize(("name", "parameter"), asked())
def test_it_says_whether_the_point_itself_counts(name, parameter):
    text = inspect.getdoc(getattr(cablejax.ops, name)) or ""
    line = re.search(rf"^    {parameter}: (.*(?:\n      .*)*)", text, re.MULTILINE)
    assert line, f"{name}: {parameter} is not described"
    assert "itself" in line[1], line[1]


def test_there_are_such_kernels():
    assert {("knn", "k"), ("radius_search", "capacity"), ("clean", "removal_k")} <= set(asked())
