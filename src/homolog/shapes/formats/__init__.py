"""The formats that shapes are read from and written to, one module for each family.

Another one is a module with ``read(path) -> Arrays``, perhaps ``write(path, shape)``, and a line below; or, from
elsewhere, ``register_format``.
"""

from homolog.shapes.formats import gltf, numpy_files, obj, off, pcd, ply, registry, stl, tables, vtk
from homolog.shapes.formats.registry import (
    Format,
    folder_suffixes,
    formats,
    imports_of,
    readable_suffixes,
    register_format,
    writable_suffixes,
)

registry.add(
    Format(".off", off.read, off.write),
    Format(".obj", obj.read, obj.write),
    Format(".ply", ply.read, ply.write, write_values=ply.write),
    Format(".stl", stl.read, stl.write, meshes_only=True),
    Format(".glb", gltf.read, gltf.write_glb, read_rest=gltf.read_rest, files_beside=gltf.buffer_files),
    Format(".gltf", gltf.read, read_rest=gltf.read_rest, files_beside=gltf.buffer_files),
    Format(".vtk", vtk.read, vtk.write_vtk),
    Format(".vtp", vtk.read, vtk.write_vtp),
    Format(".vtu", vtk.read, vtk.write_vtu),
    Format(".xyz", tables.read, tables.write_blanks, clouds_only=True, in_folders="cloud"),
    # Lists, splits and indices are text files as well.
    Format(".txt", tables.read, tables.write_blanks, clouds_only=True, in_folders="nothing"),
    Format(".csv", tables.read, tables.write_csv, clouds_only=True, in_folders="cloud"),
    Format(".npy", numpy_files.read_npy, numpy_files.write_npy, clouds_only=True, in_folders="cloud"),
    Format(".npz", numpy_files.read_npz, numpy_files.write_npz, in_folders="cloud", compressed="zip"),
    Format(".pcd", pcd.read, pcd.write, clouds_only=True, extra="pcd", in_folders="cloud"),
)

__all__ = [
    "Format",
    "folder_suffixes",
    "formats",
    "imports_of",
    "readable_suffixes",
    "register_format",
    "writable_suffixes",
]
