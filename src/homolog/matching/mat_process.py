"""SciPy's reader of MATLAB files in a process of its own, because on a damaged file it may end the whole process.

``homolog.core.reader_process`` calls ``read``. This imports nothing of Homolog.
"""

from __future__ import annotations

import numpy as np
import scipy.io


def read(path: str) -> dict[str, np.ndarray]:
    """The arrays of numbers in a MATLAB file, by their names.

    Raises:
        ValueError: if it is damaged, or of MATLAB 7.3.
    """
    try:
        found = scipy.io.loadmat(path)
    except MemoryError:
        raise
    except Exception as error:  # whatever SciPy raises of a damaged file
        raise ValueError(str(error)) from None
    arrays = {name: np.asarray(value) for name, value in found.items() if not name.startswith("__")}
    return {name: array for name, array in arrays.items() if array.dtype.kind in "biuf"}
