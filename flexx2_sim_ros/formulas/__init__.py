"""
The model's formulas on single numbers, each written once.

A formula is a plain function of float32 and whole numbers, and of flat arrays where it looks at
neighbours. It uses nothing but arithmetic, constants of NumPy's types, other formulas and the
names in `scalars`. As it stands it works on NumPy numbers and arrays. `physics.compiled` compiles
it for loops over images on the CPU, and `batch.compiled` for Warp's kernels; `Backend` is what the
two share.
"""

from collections.abc import Callable, Mapping
from types import FunctionType
from typing import Any

from flexx2_sim_ros.formulas import scalars

__all__ = ['Backend', 'on_images']


class Backend:
    """
    Compile formulas, each once, together with the formulas that they call.

    The code of a formula stays the same. Only the values of its global names change: those of
    `scalars` to the backend's own, ``names``, constants (NumPy numbers or tuples of such) by
    ``constant``. ``finish`` compiles a function whose global names all belong to the backend.
    """

    def __init__(
        self,
        names: Mapping[str, Any],
        constant: Callable[[Any], Any],
        finish: Callable[[FunctionType], Any],
    ) -> None:
        """Start without formulas."""
        self._names, self._constant, self._finish = names, constant, finish
        self._done: dict[Any, Any] = {}

    def __call__(self, formula: Callable[..., Any]) -> Any:
        """Return a formula compiled."""
        if formula not in self._done:
            self._done[formula] = self._finish(self._rebuilt(formula))
        return self._done[formula]

    def replace(self, formula: Callable[..., Any], own: Any) -> None:
        """Use the backend's own function for a formula, in what is compiled from now on."""
        self._done[formula] = own

    def _rebuilt(self, formula: Any) -> FunctionType:
        known = {
            name: self._own(name, formula.__globals__[name])
            for name in formula.__code__.co_names
            if name in formula.__globals__
        }
        rebuilt = FunctionType(formula.__code__, {'__name__': formula.__module__, **known})
        rebuilt.__qualname__, rebuilt.__doc__ = formula.__qualname__, formula.__doc__
        rebuilt.__annotations__ = dict(formula.__annotations__)
        return rebuilt

    def _own(self, name: str, value: Any) -> Any:
        if value is getattr(scalars, name, None):
            return self._names[name]
        return self(value) if isinstance(value, FunctionType) else self._constant(value)


def on_images(formula: Callable[..., Any]) -> Callable[..., Any]:
    """Return a formula for NumPy arrays, element by element: as it stands, without compiling."""
    return formula
