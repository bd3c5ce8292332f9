"""`Template`: equations of which a part is given, for the argument `template` of `atoll.discover`."""

from collections.abc import Mapping, Sequence
from typing import Self

from atoll_core.errors import UsageError
from atoll_core.quoting import did_you_mean


class Template:
    """Given equations with named parameters, which are fitted, and unknown parts ``?``, which are searched.

    For example ``Template({"dv/dt": "-g/l*sin(theta) - c*v + ?"}, parameters={"c": (0.1, 10)})``. Numbers in an
    equation are not fitted. ``?(v, u)`` is an unknown part that depends on these variables, and ``?1`` in several
    equations is the same expression.
    """

    def __init__(
        self, equations: Mapping[str, object] | Sequence[str], parameters: Mapping[str, object] | Sequence[str] = ()
    ) -> None:
        """Store the equations and the parameters; `atoll.discover` checks them.

        Args:
            equations: right-hand sides by left-hand side, or texts such as ``"dv/dt = -c*v + ?"``.
            parameters: for each name bounds ``(0.1, 10)`` (None: no bound), a start value, a text such as
                ``"1 in 0.1..10"``, or None; or texts such as ``"c=0.1..10"``. A text that ends with ``by run`` lets
                the value differ between trajectories. Other names are parameters without bounds.
        """
        self.equations = equations
        self.parameters = parameters

    def get_params(self, deep: bool = True) -> dict[str, object]:
        """Return the arguments of the constructor, as tools of scikit-learn expect."""
        del deep
        return {"equations": self.equations, "parameters": self.parameters}

    def set_params(self, **arguments: object) -> Self:
        """Change arguments of the constructor; raises UsageError for others."""
        for name, value in arguments.items():
            if name not in self.get_params():
                hint = did_you_mean(name, self.get_params())
                raise UsageError(f"{name} is not an argument of Template, which has equations and parameters{hint}")
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        parameters = f", parameters={self.parameters!r}" if self.parameters else ""
        return f"Template({self.equations!r}{parameters})"

    @property
    def options(self) -> dict[str, object]:
        """The options ``equation`` and ``parameter`` of `atoll.discover` with the same meaning."""
        given = {"equation": self.equations, "parameter": self.parameters}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in given.items() if value}
