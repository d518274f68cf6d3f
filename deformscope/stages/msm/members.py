"""Common parts of the kernel factories: the module of their kernels, and the names of their return values."""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.lanes import module_options


def kernel_in(name: str, scalar: Any, options: dict[str, Any] | None = None, **each: Any) -> Any:
    """The decorator for kernels of the module `deformscope_<name>`; each: keywords of each `wp.kernel`. options:
    options of the module, default those of lanes of `scalar`"""
    module = f"deformscope_{name}"
    wp.get_module(module).options.update(module_options(scalar) if options is None else options)

    def kernel(function: Any = None, *, name: str | None = None, **given: Any) -> Any:
        if function is None:
            return functools.partial(kernel, name=name, **given)
        function.__name__ = name or function.__name__
        return wp.kernel(name=name, module=module, enable_backward=False, **each, **given)(function)

    return kernel


def members(*made: Any, **named: Any) -> SimpleNamespace:
    """Kernels, functions and struct types by the names that they were defined with; others by the given names."""
    return SimpleNamespace(**{each.__name__: each for each in made}, **named)
