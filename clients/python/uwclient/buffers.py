"""Values that are bytes, or arrays with a type and a shape, and their forms on the wire. numpy is imported only on demand."""

from __future__ import annotations

import base64
import importlib
import math
import struct
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, cast, runtime_checkable

from uwclient.errors import CallRefused, ProtocolError, UwError, install_command

if TYPE_CHECKING:
    from numpy.typing import NDArray

FORMATS: dict[str, Any] = {
    "uint8": "B", "int8": "b", "uint16": "H", "int16": "h", "uint32": "I", "int32": "i", "float32": "f", "float64": "d",
}  # fmt: skip
"""Types of items, each with its format code for `memoryview`."""
_ITEM_BYTES = {name: struct.calcsize(f"<{code}") for name, code in FORMATS.items()}


@dataclass(frozen=True)
class Buffer:
    """An array in the form in which it crosses the wire: `data` is in row-major order and little-endian.

    Raises:
        ValueError: type, shape and number of bytes do not fit together.
    """

    dtype: str
    shape: tuple[int, ...]
    data: bytes

    def __post_init__(self) -> None:
        if self.dtype not in FORMATS:
            raise ValueError(f"no dtype {self.dtype!r:.40}, there are: {', '.join(FORMATS)}")
        if any(isinstance(extent, bool) or not 0 <= extent < 1 << 32 for extent in self.shape):
            raise ValueError("a shape is a list of whole numbers from 0 to 4294967295")
        wanted = math.prod(self.shape) * _ITEM_BYTES[self.dtype]
        if wanted != len(self.data):
            raise ValueError(f"{self.dtype} of shape {list(self.shape)} are {wanted} bytes, not {len(self.data)}")

    @classmethod
    def of(cls, array: NDArray[Any]) -> Buffer:
        """Copy a numpy array. Raises ValueError if its type is not supported."""
        name = str(array.dtype.name)
        if name not in FORMATS:
            raise ValueError(f"no buffer of {name}: convert the array to one of {', '.join(FORMATS)}")
        return cls(name, tuple(array.shape), array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes())

    @property
    def view(self) -> memoryview[Any]:
        """The items, without numpy and without a copy: `view[row, column]`, `view.tolist()`."""
        if sys.byteorder != "little" and _ITEM_BYTES[self.dtype] > 1:
            raise UwError("this machine is big-endian: read the buffer with numpy", code="unsupported")
        items: Any = memoryview(self.data)
        # A memoryview cannot have empty dimensions.
        shaped = items.cast(FORMATS[self.dtype], *([] if 0 in self.shape else [self.shape]))
        return cast("memoryview[Any]", shaped)

    def array(self) -> NDArray[Any]:
        """Return the items as a read-only numpy array of their shape and type, without a copy. Raises UwError without numpy."""
        try:
            np = importlib.import_module("numpy")
        except ImportError:
            raise UwError(
                f"Buffer.array needs numpy: {install_command('uwclient[numpy]')} (or use Buffer.view)",
                code="missing_package",
            ) from None
        flat = np.frombuffer(self.data, np.dtype(self.dtype).newbyteorder("<"))
        return cast("NDArray[Any]", flat.reshape(self.shape))


@runtime_checkable
class _Array(Protocol):
    """A numpy array, recognised without importing numpy."""

    dtype: Any

    def astype(self, dtype: Any) -> Any: ...


def packed(value: object) -> object:
    """Return `value` for a buffer field: arrays as Buffer, bytes-like objects as bytes. Raises CallRefused for unsupported arrays."""
    try:
        if isinstance(value, _Array):
            return Buffer.of(cast("Any", value))
    except ValueError as error:
        raise CallRefused(str(error), code="bad_argument") from None
    return bytes(cast("bytes", value)) if isinstance(value, (bytearray, memoryview)) else value


def as_text(value: object) -> object:
    """Return bytes and buffers in their JSON form, for a JSON encoder. Raises TypeError for any other object."""
    if isinstance(value, bytes):
        return {"base64": base64.b64encode(value).decode("ascii")}
    if isinstance(value, Buffer):
        data = base64.b64encode(value.data).decode("ascii")
        return {"dtype": value.dtype, "shape": value.shape, "base64": data}
    raise TypeError(f"JSON has no form for {type(value).__name__}")


def as_binary(value: object) -> object:
    """Return buffers in their msgpack form, for a msgpack encoder. Raises TypeError for any other object."""
    if isinstance(value, Buffer):
        return {"dtype": value.dtype, "shape": value.shape, "data": value.data}
    raise TypeError(f"msgpack has no form for {type(value).__name__}")


def unpacked(value: object) -> object:
    """Return bytes or a Buffer from their form on the wire, and any other value as it is. Raises ProtocolError."""
    if not isinstance(value, dict):
        return value
    given = cast("dict[str, object]", value)
    try:
        text = given.get("base64")
        data = base64.b64decode(text, validate=True) if isinstance(text, str) else given.get("data")
        if not isinstance(data, bytes):
            raise ValueError("it has neither base64 nor data")
        if "dtype" not in given:
            return data
        shape = given.get("shape", [])
        if not isinstance(shape, (list, tuple)) or not all(isinstance(n, int) for n in cast("list[object]", shape)):
            raise ValueError("its shape is no list of whole numbers")
        return Buffer(str(given["dtype"]), tuple(cast("list[int]", shape)), data)
    except ValueError as error:
        raise ProtocolError(f"the server sent a value that is no buffer: {error}", code="protocol") from None
