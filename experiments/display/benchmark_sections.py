"""Sections of the benchmarks: speed, scaling, files, and the measurement beside known truth."""

from experiments.analysis.benchmark import Benchmark
from experiments.display.benchmarks import figures as benchmark_figures
from experiments.display.benchmarks import speed_tables
from experiments.display.benchmarks import tables as benchmark_tables
from experiments.display.measurement import figures as measure_figures
from experiments.display.measurement import parts_tables, search_tables
from experiments.display.measurement import tables as measure_tables
from experiments.display.section import Section, of

TIMED = (
    "benchmarks/neighbors_53135",
    "benchmarks/removal_53135",
    "benchmarks/neighbors_features",
    "benchmarks/train_adgcnn_inference",
    "benchmarks/train_adgcnn_step",
    "benchmarks/simulate",
)

BENCHMARKS: tuple[Section[Benchmark], ...] = (
    Section(
        Benchmark,
        "Speed",
        "Each kernel beside the library that people use for it, on the same data and in the same process.",
        (*TIMED, "benchmarks/filters"),
        (speed_tables.speed, of("benchmarks/filters", speed_tables.cleaning)),
        (benchmark_figures.speed,),
    ),
    Section(
        Benchmark,
        "Scaling",
        "From a hundred thousand points upwards.",
        ("benchmarks/scale",),
        (),
        (of("benchmarks/scale", benchmark_figures.scaling),),
    ),
    Section(
        Benchmark,
        "Registration",
        "Two clouds onto each other, beside Open3D.",
        ("benchmarks/registration",),
        (speed_tables.registration,),
    ),
    Section(
        Benchmark,
        "Denoising",
        "The adaptive filter on free-form shapes with public truth, and its defaults on cables of other sizes.",
        ("benchmarks/denoise", "benchmarks/cables"),
        (of("benchmarks/denoise", benchmark_tables.denoise), of("benchmarks/cables", benchmark_tables.cables)),
        (of("benchmarks/denoise", benchmark_figures.denoise),),
    ),
    Section(
        Benchmark,
        "Simulator",
        "Training clouds a minute.",
        ("benchmarks/simulate",),
        (of("benchmarks/simulate", benchmark_tables.simulator),),
    ),
    Section(
        Benchmark,
        "Networks",
        "Size and speed of the paper's network and of those beside it.",
        ("benchmarks/networks",),
        (of("benchmarks/networks", benchmark_tables.networks),),
    ),
    Section(
        Benchmark,
        "Files",
        "Good, odd and damaged files of every format.",
        ("benchmarks/parsers", "benchmarks/fuzz"),
        (of("benchmarks/parsers", benchmark_tables.readers), of("benchmarks/fuzz", benchmark_tables.damaged)),
    ),
    Section(
        Benchmark,
        "Accuracy",
        "The diameter on simulated scans of every size, beside the straight cylinder that is commonly fitted.",
        ("benchmarks/measure",),
        (of("benchmarks/measure", measure_tables.accuracy),),
    ),
    Section(
        Benchmark,
        "Coverage",
        "Whether the 95 % interval of the diameter holds the truth in 95 of 100 scans.",
        ("benchmarks/coverage",),
        (of("benchmarks/coverage", measure_tables.coverage),),
        (
            of("benchmarks/coverage", measure_figures.coverage),
            of("benchmarks/coverage", measure_figures.calibration),
        ),
    ),
    Section(
        Benchmark,
        "Real scans of known size",
        "Round things of known size under real scanners: which intervals hold, and what six of the scans look like.",
        ("benchmarks/real",),
        (of("benchmarks/real", measure_tables.real_grades),),
        (
            of("benchmarks/real", measure_figures.real_intervals),
            of("benchmarks/real", measure_figures.real_pictures),
        ),
    ),
    Section(
        Benchmark,
        "The search",
        "Cylinders of CAD models, and cables among crates, cans and points anywhere.",
        ("benchmarks/fit4cad", "benchmarks/clutter"),
        (of("benchmarks/fit4cad", search_tables.cad_cylinders), of("benchmarks/clutter", search_tables.clutter)),
    ),
    Section(
        Benchmark,
        "A known scanner",
        "What the numbers of the scanner, where they are given, do for the diameter.",
        (parts_tables.PLAIN, parts_tables.KNOWN),
        (parts_tables.known_scanner,),
    ),
    Section(
        Benchmark,
        "Cables among other things",
        "What the labels of a network do for the diameter.",
        (parts_tables.BENCHMARK,),
        (of(parts_tables.BENCHMARK, parts_tables.measured),),
    ),
    Section(
        Benchmark,
        "Real scans",
        "Round things from public test data.",
        ("benchmarks/measure",),
        (of("benchmarks/measure", measure_tables.real_scans),),
    ),
)
