"""Many tasks in processes of their own, on this machine or a cluster: a crash costs one retry, a kill the tasks in flight."""

from cablejax.batch.engine import Dask, Engine, EngineError, Here, Processes, engine_for
from cablejax.batch.table import Column, Row, Table, TableError, columns_of
from cablejax.batch.task import Outcome, Task

__all__ = [
    "Column",
    "Dask",
    "Engine",
    "EngineError",
    "Here",
    "Outcome",
    "Processes",
    "Row",
    "Table",
    "TableError",
    "Task",
    "columns_of",
    "engine_for",
]
