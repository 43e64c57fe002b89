"""A name of `cablejax.simulate` is one thing: no function hides the module that it comes from."""

import pkgutil
import types

from cablejax import simulate


def test_no_function_hides_a_module():
    for module in pkgutil.iter_modules(simulate.__path__):
        assert isinstance(getattr(simulate, module.name, types), types.ModuleType), module.name
