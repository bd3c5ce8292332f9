"""Results as small as a model needs them."""

from dataclasses import replace
from typing import Any, Final

import numpy as np

from atoll_core.expression.program import constant_places
from atoll_core.expression.template import ZERO, ConstantSource, TemplateParameter, read_template
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix


def result(equations: dict[str, str], inputs: tuple[str, ...] = (), **changes: Any) -> dict[str, Any]:
    """Return the content of a result.json: dx/dt = expression for each of `equations`."""
    names = [*equations, *inputs]
    entries = [
        {
            "variable": name,
            "lhs": f"d{name}/dt",
            "expression": text,
            "program": from_infix(text, names).to_bytes().hex(),
            "complexity": 5,
            "constants": [],
            "candidates": [],
            "front": [],
            "verdict": "good",
            "reason": "It fits & more.",
        }
        for name, text in equations.items()
    ]
    return {
        "schema": 1,
        "job": "j",
        "seed": 7,
        "equations": entries,
        "symbols": {name: name for name in names},
        "system": {"time": "t", "units": {}, "ranges": {name: [0.0, 1.0] for name in names}},
        "data": {"digest": "ab", "files": ["a.csv"], "rows": 3},
        "simulation": None,
        "covariance": None,
        "digest": "cd",
        **changes,
    }


def constant(value: float, error: float) -> dict[str, Any]:
    """Return a constant with its standard error, as a result has it."""
    bounds = [value - 2.0 * error, value + 2.0 * error]
    return {"value": value, "std_error": error, "fitted": value, "interval": bounds, "identifiable": True}


def process_result(drift: str = "1-x", diffusion: str = "0.25", inputs: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the content of the result.json of a process of one state that was measured in steps of 0.1 from 2."""
    contents = result({"x": drift, "[x]": diffusion}, inputs)
    del contents["symbols"]["[x]"]
    for equation in contents["equations"]:  # a program is over the symbols
        del equation["program"]
    ensemble = {"trajectory": "1", "times": [0.0, 0.5], "mean": {"x": [2.0, 1.6]}}
    return contents | {"process": {"step": 0.1, "ensemble": ensemble}}


BIOREACTOR: Final = {"X": "?1(S)*X - 0.2*X", "S": "-?1(S)*X/Y + 0.2*(3 - S)"}
"""Given sides of a bioreactor: ?1 is the growth rate, Y the yield."""


def given_entries(
    sides: dict[str, str], parts: dict[str, str], values: dict[str, float], bounds: dict[str, Any] | None = None
) -> dict[str, dict[str, Any]]:
    """Return keys of the equations of a result with given sides, by variable.

    Args:
        sides: the sides as the user wrote them.
        parts: the unknown parts by label.
        values: the values of the parameters.
        bounds: bounds of parameters by name.
    """
    names = tuple(sides)
    template = read_template(sides, {name: TemplateParameter(name) for name in values}, names)
    found = {label: from_infix(text, names, merges_constants=False) for label, text in parts.items()}
    slots = {unknown.home: found[unknown.label] for unknown in template.unknowns}
    template = replace(template, equations=names)
    known = np.array([values[one.name] for one in template.parameters])
    composition = template.compose([slots.get(name, ZERO) for name in names], known)
    entries = {}
    for index, (name, text) in enumerate(sides.items()):
        program, sources = composition.programs[index], composition.sources(index)
        called = template.parameter_names(sources)
        numbers = program.constants[constant_places(program)].tolist()
        labels = [template.unknowns[place].label for place in template.unknowns_in(name)]
        constants = [constant(value, 0.01) for value in numbers]
        for place in (place for place, source in enumerate(sources) if source == ConstantSource()):
            constants[place] = {"value": numbers[place], "std_error": None, "fitted": None, "interval": None}
        for place, parameter in enumerate(called):
            constants[place]["bounds"] = (bounds or {}).get(parameter or "")
        entries[name] = {
            "expression": to_infix(program, names),
            "program": program.to_bytes().hex(),
            "origin": "front" if template.unknown_of(name) else "known",
            "constants": constants,
            "given": {
                "text": text,
                "parameters": {parameter: place for place, parameter in enumerate(called) if parameter},
                "unknowns": [
                    {"label": label, "expression": parts[label], "program": found[label].to_bytes().hex()}
                    for label in labels
                ],
            },
        }
    return entries


def bioreactor(**changes: Any) -> dict[str, Any]:
    """Return the content of a result.json with the growth rate S/(0.6 + 2 S) as unknown part, and the yield 0.5."""
    entries = given_entries(BIOREACTOR, {"?1": "S/(0.6 + 2.0*S)"}, {"Y": 0.5}, {"Y": [0.1, 2.0]})
    return with_given(result(dict.fromkeys(BIOREACTOR, "1"), **changes), entries)


def with_given(contents: dict[str, Any], entries: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return a result whose equations have these keys by variable."""
    equations = [entry | entries[entry["variable"]] for entry in contents["equations"]]
    return contents | {"equations": equations}
