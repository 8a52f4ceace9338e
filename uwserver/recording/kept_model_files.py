"""Stores model files (glTF) in the head of a recording, so that playback shows them without the files. Their size is limited, and they are checked
again when they are read."""

from __future__ import annotations

import base64
import hashlib
import logging
from collections.abc import Mapping

import msgspec
import zstandard

from uwserver.physics.geometry.shapes import BadSolid
from uwserver.scenario.load.resolved import Resolved
from uwserver.scenario.solids.appearance import check_glb

log = logging.getLogger(__name__)

MODEL_FILES = "looks_base64"
"""Key in the metadata record. Earlier recordings have the key `looks` in base 85, which takes seconds and 50 times the memory to decode; they are
played without looks."""
MOST_BYTES = 32 << 20
"""Largest total size of the files. If they are larger, the largest files are left out."""


class _Kept(msgspec.Struct):
    """Files by their hash, and the hash of each owner: ``vehicles/rov``, ``objects/crate``, ``static/pile``."""

    files: dict[str, bytes]
    owners: dict[str, str]


def pack_model_files(resolved: Resolved) -> dict[str, str]:
    """Return the entry for the metadata record; empty when there are no files."""
    worn = {f"vehicles/{name}": vehicle.looks for name, vehicle in resolved.vehicles.items()}
    worn |= {f"objects/{name}": body.looks for name, body in resolved.objects.items()}
    worn |= {f"static/{name}": data for name, data in resolved.looks.items()}
    owners = {owner: hashlib.sha256(data).hexdigest() for owner, data in worn.items() if data}
    files = {owners[owner]: data for owner, data in worn.items() if data}
    size, kept = 0, dict[str, bytes]()
    for sha256, data in sorted(files.items(), key=lambda file: (len(file[1]), file[0])):
        size += len(data)
        if size <= MOST_BYTES:
            kept[sha256] = data
    if left_out := [owner for owner, sha256 in owners.items() if sha256 not in kept]:
        log.warning(
            "the looks of %s are left out of the recording: all looks together have more than %d bytes",
            ", ".join(left_out),
            MOST_BYTES,
        )
    if not kept:
        return {}
    packed = msgspec.msgpack.encode(_Kept(kept, {owner: sha for owner, sha in owners.items() if sha in kept}))
    return {MODEL_FILES: base64.b64encode(zstandard.ZstdCompressor().compress(packed)).decode()}


def unpack_model_files(record: Mapping[str, str]) -> Mapping[str, bytes]:
    """Return the files by their owners, as `pack_model_files` names them, without those that fail the check.

    Raises:
        ValueError: the record was not made by `pack_model_files`.
    """
    if MODEL_FILES not in record:
        return {}
    try:
        packed = base64.b64decode(record[MODEL_FILES], validate=True)
        most = 2 * MOST_BYTES
        if zstandard.frame_content_size(packed) > most:
            raise ValueError(f"looks of more than {most} bytes")
        kept = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(packed, max_output_size=most), type=_Kept)
    except (zstandard.ZstdError, ValueError) as error:  # msgspec's errors are ValueErrors
        raise ValueError(f"the looks cannot be read: {error}") from error
    fine = {sha256: data for sha256, data in kept.files.items() if _is_fine(data)}
    return {owner: fine[sha256] for owner, sha256 in kept.owners.items() if sha256 in fine}


def _is_fine(data: bytes) -> bool:
    try:
        check_glb(data)
    except BadSolid as error:
        log.warning("looks in the recording are not shown: %s", error)
        return False
    return True
