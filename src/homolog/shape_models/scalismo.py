"""Export to scalismo: a shape model as HDF5 in the layout of statismo, version 0.9, which scalismo reads as ``.h5``.

The mean is the reference. Arrays are single precision, vectors run point by point, points and cells column by column.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Int

from homolog.core.errors import needs_extra
from homolog.core.files import atomic_path
from homolog.statistics import ShapeModel

_VERSION = (0, 9)


def write_scalismo(path: Path, model: ShapeModel, faces: Int[np.ndarray, "m 3"] | None) -> None:
    """Write a model of a mesh or, without faces, of a point set.

    Raises:
        ArgumentError: if the file cannot be written.
        MissingExtraError: without the extra ``collection``.
    """
    with needs_extra("models for scalismo", "collection"):
        import h5py
    kind = "POINT_SET" if faces is None else "POLYGON_MESH"
    with atomic_path(path) as temporary, h5py.File(temporary, "w") as file:
        file["model/mean"] = model.mean.ravel().astype(np.float32)
        file["model/pcaBasis"] = model.modes.reshape(len(model.modes), -1).T.astype(np.float32)
        file["model/pcaVariance"] = model.variances.astype(np.float32)
        file["model/noiseVariance"] = np.zeros(1, dtype=np.float32)
        file["representer/points"] = model.mean.T.astype(np.float32)
        if faces is not None:
            file["representer/cells"] = faces.T.astype(np.int32)
        named = {"name": "itkStandardMeshRepresenter", "datasetType": kind}
        for name, value in {**named, "version/majorVersion": "0", "version/minorVersion": "9"}.items():
            file["representer"].attrs[name] = np.bytes_(value)
        for name, number in zip(("majorVersion", "minorVersion"), _VERSION, strict=True):
            file[f"version/{name}"] = np.int32(number)
        file["modelinfo/build-time"] = np.bytes_("")
