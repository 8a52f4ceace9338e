"""Values that are bytes, or arrays as bytes with a type and a shape, and their forms on the wire. numpy is used where it is asked for."""

from __future__ import annotations

import base64
import importlib
import math
import struct
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, cast, runtime_checkable

from uwclient.errors import CallRefused, ProtocolError, UwError

if TYPE_CHECKING:
    from numpy.typing import NDArray

FORMATS: dict[str, Any] = {
    "uint8": "B", "int8": "b", "uint16": "H", "int16": "h", "uint32": "I", "int32": "i", "float32": "f", "float64": "d",
}  # fmt: skip
"""Types of items, with what `memoryview` calls them."""
_ITEM_BYTES = {name: struct.calcsize(f"<{code}") for name, code in FORMATS.items()}


@dataclass(frozen=True)
class Buffer:
    """An array that crosses the wire as it is: `data` in row-major order, little-endian.

    Raises:
        ValueError: type, shape and number of bytes do not fit each other.
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
        """Copy a numpy array; raises ValueError for one of another type."""
        name = str(array.dtype.name)
        if name not in FORMATS:
            raise ValueError(f"no buffer of {name}: convert the array to one of {', '.join(FORMATS)}")
        return cls(name, tuple(array.shape), array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes())

    @property
    def view(self) -> memoryview[Any]:
        """The items without numpy and without a copy: `view[row, column]`, `view.tolist()`."""
        if sys.byteorder != "little" and _ITEM_BYTES[self.dtype] > 1:
            raise UwError("this machine is big-endian: read the buffer with numpy", code="unsupported")
        items: Any = memoryview(self.data)
        # A memoryview has no empty dimensions.
        shaped = items.cast(FORMATS[self.dtype], *([] if 0 in self.shape else [self.shape]))
        return cast("memoryview[Any]", shaped)

    def array(self) -> NDArray[Any]:
        """The items as numpy array of their shape and type, read-only, without a copy; raises UwError without numpy."""
        try:
            np = importlib.import_module("numpy")
        except ImportError:
            raise UwError(
                "Buffer.array needs numpy: pip install 'uwclient[numpy]' (or use Buffer.view)", code="missing_package"
            ) from None
        flat = np.frombuffer(self.data, np.dtype(self.dtype).newbyteorder("<"))
        return cast("NDArray[Any]", flat.reshape(self.shape))


@runtime_checkable
class _Array(Protocol):
    """A numpy array, recognised without importing numpy."""

    dtype: Any

    def astype(self, dtype: Any) -> Any: ...


def packed(value: object) -> object:
    """Return what stands for `value` in a buffer field: arrays and bytes-likes as Buffer and bytes; raises CallRefused."""
    try:
        if isinstance(value, _Array):
            return Buffer.of(cast("Any", value))
    except ValueError as error:
        raise CallRefused(str(error), code="bad_argument") from None
    return bytes(cast("bytes", value)) if isinstance(value, (bytearray, memoryview)) else value


def as_text(value: object) -> object:
    """For JSON: what its encoder does not know; raises TypeError for what it cannot know."""
    if isinstance(value, bytes):
        return {"base64": base64.b64encode(value).decode("ascii")}
    if isinstance(value, Buffer):
        data = base64.b64encode(value.data).decode("ascii")
        return {"dtype": value.dtype, "shape": value.shape, "base64": data}
    raise TypeError(f"{type(value).__name__} is no JSON")


def as_binary(value: object) -> object:
    """The same for msgpack."""
    if isinstance(value, Buffer):
        return {"dtype": value.dtype, "shape": value.shape, "data": value.data}
    raise TypeError(f"{type(value).__name__} is no msgpack")


def unpacked(value: object) -> object:
    """Return bytes or a Buffer for what stands for them on a wire, anything else as it is; raises ProtocolError."""
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
