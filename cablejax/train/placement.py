"""Where training's arrays live: one device, all devices of a machine, or those of several processes."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec


class Placement:
    """Data parallel training: the state and the data on every device, each batch cut over them.

    XLA adds up gradients and batch statistics across devices, so that losses are those of one device up to the order of
    sums. With several processes (after `jax.distributed.initialize`) each makes the same calls with the same data.

    Args:
        devices: None takes all devices of all processes.
    """

    def __init__(self, devices: Sequence[jax.Device] | None = None):  # pyright: ignore[reportInvalidTypeForm]
        self.devices = list(jax.devices() if devices is None else devices)
        self.mesh = Mesh(np.array(self.devices), ("clouds",))
        self.everywhere = NamedSharding(self.mesh, PartitionSpec())
        self.by_cloud = NamedSharding(self.mesh, PartitionSpec(None, "clouds"))
        self.writes = jax.process_index() == 0

    def check(self, batch_size: int) -> None:
        """Raise `ValueError` where a batch cannot be cut into equal parts."""
        if batch_size % len(self.devices):
            raise ValueError(
                f"batch_size: expected a multiple of the {len(self.devices)} devices, got {batch_size}; "
                "take another size, or give `devices`"
            )

    def meet(self) -> None:
        """Wait for the other processes: what the first one wrote before it came here, all can read afterwards."""
        if jax.process_count() > 1:
            multihost_utils.sync_global_devices("cablejax.train")

    def replicate(self, tree: Any) -> Any:
        """The tree with every array on every device."""
        return jax.tree.map(lambda leaf: self._put(leaf, self.everywhere), tree)

    def cut(self, rows: Any) -> Any:
        """Rows of batches `[s, b]`, each batch cut over the devices."""
        return self._put(rows, self.by_cloud)

    def local(self, tree: Any) -> Any:
        """The tree with every array on this process's first device alone."""
        return jax.tree.map(lambda leaf: leaf.addressable_data(0), tree)

    def _put(self, leaf: Any, sharding: NamedSharding) -> Any:
        if len(self.devices) == 1:
            return jax.device_put(leaf, self.devices[0])
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            data = self._put(jax.random.key_data(leaf), sharding)
            return jax.random.wrap_key_data(data, impl=jax.random.key_impl(leaf))
        host = np.asarray(leaf)
        return jax.make_array_from_callback(host.shape, sharding, lambda index: host[index])
