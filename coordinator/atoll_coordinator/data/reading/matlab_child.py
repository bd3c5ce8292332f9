"""The process that reads a MATLAB file of versions 5 to 7 by scipy, which a damaged file may end without an exception.

``python -m atoll_coordinator.data.reading.matlab_child FILE`` writes the arrays to stdout as NPZ: ``names`` as JSON,
and the arrays by their number among these.
"""

import io
import json
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from atoll_core.data.dataset import AnyArray


def main() -> None:
    """Read the file that the command line names; an error ends the process."""
    import scipy.io

    values: dict[str, object] = scipy.io.loadmat(sys.argv[1], simplify_cells=True)
    arrays = flat({name: value for name, value in values.items() if not name.startswith("__")})
    packed = io.BytesIO()
    numbered: dict[str, Any] = {  # keywords of numpy
        str(number): array for number, array in enumerate(arrays.values())
    }
    np.savez(packed, names=np.array(json.dumps([*arrays])), **numbered)
    sys.stdout.buffer.write(packed.getvalue())


def flat(values: Mapping[str, object]) -> dict[str, AnyArray]:
    """Return the arrays, those of structures by the field's name, or by both names where it is taken.

    What holds no numbers or text becomes a single empty text.
    """
    arrays: dict[str, AnyArray] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            inner = flat(value)
            arrays |= {field if field not in arrays else f"{name}.{field}": part for field, part in inner.items()}
        else:
            is_plain = isinstance(value, (np.ndarray, np.generic, str, int, float, complex))
            array = np.asarray(value) if is_plain else np.array("")
            arrays[name] = array if array.dtype.kind in "biufcU" and array.ndim <= 2 else np.array("")
    return arrays


if __name__ == "__main__":
    main()
