"""No process that lives long keeps what it was asked once: caches have a bound, by number or by what there is."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
UNBOUNDED = {
    "_codec": "of the types of values that programs write and read",
    "_digest": "of the packages whose kernels are compiled",
    "_end_idle_processes": "of the processes that are forked from one another",
    "_end_with_parent": "of the processes that are forked from one another",
    "_index": "of the folder of a wheel's kernels",
    "_style": "of the style sheets that come with the package",
    "_version": "of the packages that results name",
    "wheel_kernels": "of the packages whose kernels are compiled",
}


def without_bound() -> set[str]:
    """Return names of functions all of whose values are kept."""
    names = set()
    for folder in ("common", "coordinator", "island_worker"):
        for path in (ROOT / folder).rglob("*.py"):
            source = path.read_text("utf-8")
            for node in ast.walk(ast.parse(source)) if "cache" in source else ():
                if isinstance(node, ast.FunctionDef):
                    names |= {
                        node.name for decorator in node.decorator_list if _keeps_all(ast.unparse(decorator), node)
                    }
    return names


def _keeps_all(decorator: str, function: ast.FunctionDef) -> bool:
    name, _, bound = decorator.removeprefix("functools.").partition("(")
    has_arguments = bool(function.args.args or function.args.kwonlyargs or function.args.vararg)
    return has_arguments and (name == "cache" or (name == "lru_cache" and "None" in bound))


def test_caches_have_a_bound() -> None:
    assert without_bound() == set(UNBOUNDED)
