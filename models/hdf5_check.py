"""What an HDF5 file may hold before anything of it is followed or loaded: few plain arrays, all inside."""

from __future__ import annotations

from pathlib import Path

import h5py

from models.errors import Phrase, located

LARGEST_HDF5 = 8 << 30
"""Bytes that the arrays of a file may fill once they are loaded: chunks that were never written cost no disk."""

MOST_OBJECTS = 2_000
"""Groups and arrays."""

DEEPEST = 8
"""Groups within groups."""


def check_hdf5(path: str | Path, limit: int = LARGEST_HDF5) -> None:
    """Refuse links (to other files, to other places, of a group to itself), arrays kept elsewhere, and bombs.

    Raises
    ------
    InputError
        Naming the object.
    OSError, RuntimeError, ValueError, KeyError, TypeError, AttributeError
        From the library, of a file that is no HDF5 or is damaged.
    """
    place, left, objects, total = str(path), [("", 0)], 0, 0
    with h5py.File(path, "r") as file:
        while left:
            name, depth = left.pop()
            group = file[name or "/"]
            for own in group:
                inner = f"{name}/{own}"
                where = f"{place}, {inner}"
                objects += 1
                if objects > MOST_OBJECTS or depth >= DEEPEST:
                    raise located(place, Phrase("more objects"), f"at most {MOST_OBJECTS}, {DEEPEST} levels deep")
                if type(group.get(own, getlink=True)) is not h5py.HardLink:
                    raise located(where, Phrase("a link"), "an array or a group")
                found = group[own]
                if h5py.h5o.get_info(found.id).rc != 1:
                    raise located(where, Phrase("an object with several names"), "one name each")
                if isinstance(found, h5py.Group):
                    left.append((inner, depth + 1))
                elif isinstance(found, h5py.Dataset):
                    total += _bytes(found, where)
                    if total > limit:
                        raise located(where, Phrase(f"{total} bytes so far"), f"at most {limit} in a file")


def _bytes(array: h5py.Dataset, where: str) -> int:
    if array.is_virtual or array.external:
        raise located(where, Phrase("an array whose numbers lie in another file"), "all of them in this one")
    size = 1
    for length in array.shape or ():
        size *= int(length)
    return size * max(1, int(array.dtype.itemsize))
