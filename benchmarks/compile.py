"""How large each public kernel is as a program, and what it costs to compile: `python -m benchmarks.compile --write`.

For every kernel, in a process of its own and with no compilation cache: lines of StableHLO, compiled kernels (fusions, sorts,
scatters and the like in the optimised module), seconds of tracing, lowering and compiling, and the process's peak memory.
"""

import argparse
import json
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks import record

RESULT = Path("results/benchmarks/compile.json")
OPERATIONS = "fusion|sort|scatter|dot|reduce|gather|convolution|custom-call"
KERNELS = (
    "knn", "knn queries", "radius_search", "radius_count", "statistical_outliers", "radius_outliers", "median_outliers",
    "clean order 0", "clean order 2 k 100", "adaptive_filter order 2", "feature_graph", "build_tree", "query", "knn ragged",
    "knn in a box", "knn_graph", "farthest_point_sampling", "ball_query", "voxel_downsample", "estimate_normals",
    "orient_normals",
)  # fmt: skip


def program(name: str, points: int) -> tuple[Callable[..., Any], tuple[Any, ...]]:
    """A kernel as a function of arrays alone, and the shapes of its arguments."""
    import jax
    import jax.numpy as jnp

    from cablejax import ops
    from cablejax.types import PointCloud

    xyz = jax.ShapeDtypeStruct((points, 3), jnp.float32)
    some = jax.ShapeDtypeStruct((points // 10, 3), jnp.float32)
    features = jax.ShapeDtypeStruct((1024, 64), jnp.float32)
    splits, rows = jax.ShapeDtypeStruct((17,), jnp.int32), jax.ShapeDtypeStruct((points, 20), jnp.int32)

    def whole(xyz: jax.Array) -> PointCloud:
        return PointCloud(xyz, jnp.ones(xyz.shape[0], dtype=bool))

    programs: dict[str, tuple[Callable[..., Any], tuple[Any, ...]]] = {
        "knn": (lambda xyz: ops.knn(xyz, k=20), (xyz,)),
        "knn queries": (lambda xyz, queries: ops.knn(xyz, k=20, queries=queries), (xyz, some)),
        "radius_search": (lambda xyz: ops.radius_search(xyz, radius=1.0, capacity=20), (xyz,)),
        "radius_count": (lambda xyz: ops.radius_count(xyz, radius=1.0), (xyz,)),
        "statistical_outliers": (lambda xyz: ops.statistical_outliers(whole(xyz), k=20), (xyz,)),
        "radius_outliers": (lambda xyz: ops.radius_outliers(whole(xyz), radius=1.0, min_neighbors=5), (xyz,)),
        "median_outliers": (lambda xyz: ops.median_outliers(whole(xyz), k=20), (xyz,)),
        "clean order 0": (lambda xyz: ops.clean(whole(xyz), removal_k=20, k=20, order=0), (xyz,)),
        "clean order 2 k 100": (lambda xyz: ops.clean(whole(xyz), k=100, order=2), (xyz,)),
        "adaptive_filter order 2": (lambda xyz: ops.adaptive_filter(whole(xyz), k=40, order=2), (xyz,)),
        "feature_graph": (lambda rows: ops.knn_features(rows, k=20), (features,)),
        "build_tree": (lambda xyz: ops.build_tree(xyz), (xyz,)),
        "query": (lambda tree: ops.query(tree, k=20), (jax.eval_shape(ops.build_tree, xyz),)),
        "knn ragged": (lambda xyz, splits: ops.knn(xyz, k=20, row_splits=splits), (xyz, splits)),
        "knn in a box": (lambda xyz: ops.knn(xyz, k=20, box=jnp.ones(3)), (xyz,)),
        "knn_graph": (lambda xyz: ops.knn_graph(xyz, k=20), (xyz,)),
        "farthest_point_sampling": (lambda xyz: ops.farthest_point_sampling(xyz, count=1024), (xyz,)),
        "ball_query": (lambda xyz, some: ops.ball_query(xyz, some, radius=1.0, capacity=32), (xyz, some)),
        "voxel_downsample": (lambda xyz: ops.voxel_downsample(xyz, size=1.0), (xyz,)),
        "estimate_normals": (lambda xyz: ops.estimate_normals(xyz, k=20), (xyz,)),
        "orient_normals": (ops.orient_normals, (xyz, xyz, rows)),
    }
    return programs[name]


def measure(name: str, points: int) -> dict[str, Any]:
    """Trace, lower and compile one kernel in this process."""
    import resource

    import jax

    jax.config.update("jax_enable_compilation_cache", False)
    function, shapes = program(name, points)
    start = time.perf_counter()
    traced = jax.jit(function).trace(*shapes)
    first = time.perf_counter()
    lowered = traced.lower()
    second = time.perf_counter()
    compiled = lowered.compile()
    third = time.perf_counter()
    return {
        "lines": lowered.as_text().count("\n"),
        "kernels": kernels(compiled.as_text() or ""),
        "trace_s": first - start,
        "lower_s": second - first,
        "compile_s": third - second,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def kernels(text: str) -> int:
    """Instructions of an optimised module that run as kernels of their own: not those within fusions and reductions."""
    within = set(re.findall(r"(?:calls|to_apply)=%?([\w.\-]+)", text))
    count, inside = 0, False
    for line in text.splitlines():
        if header := re.match(r"(?:ENTRY )?%?([\w.\-]+) \(.*\{$", line):
            inside = header[1] in within
        count += not inside and bool(re.search(rf"= \S.* (?:{OPERATIONS})\(", line))
    return count


def main() -> None:
    """Measure every kernel in a process of its own, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=53_135)
    parser.add_argument("--only", choices=KERNELS, help="measure this one here and print it as JSON")
    parser.add_argument("--write", action="store_true", help=f"write {RESULT}; leave it out on a busy machine")
    options = parser.parse_args()
    if options.only:
        print(json.dumps(measure(options.only, options.points)))
        return
    rows = []
    print(f"{'':26s}{'lines':>8s}{'kernels':>9s}{'trace':>8s}{'lower':>8s}{'compile':>9s}{'peak':>9s}")
    for name in KERNELS:
        command = [sys.executable, "-m", "benchmarks.compile", "--only", name, "--points", str(options.points)]
        out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        row = {"kernel": name, **json.loads(out.splitlines()[-1])}
        rows.append(row)
        seconds = "".join(f"{row[key]:{width}.1f}" for key, width in (("trace_s", 8), ("lower_s", 8), ("compile_s", 9)))
        print(f"{name:26s}{row['lines']:8d}{row['kernels']:9d}{seconds}{row['peak_mb']:6.0f} MB", flush=True)
    if options.write:
        config = {"points": options.points}
        record.write(RESULT, {"kernels": record.table(rows, config=config)}, config=config)


if __name__ == "__main__":
    main()
