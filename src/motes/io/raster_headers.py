"""What kind of raster a file is by its first bytes, and whether its header is believable."""

import re

import numpy as np

from motes.io.files import reject

HEADER_BYTES = 4096
UHL, DSI, ACC = 80, 648, 2700
SENTINEL = 0xAA
LOWEST_MAGNITUDE = 12_000
"""Meters; no sea is deeper, so that what seems to be is stored in another way."""
TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def kind_of(name: str, file_name: str, start: bytes) -> str:
    """Return what a raster file is: "DTED", "GTiff", "npz" (a zip archive) or "HGT" (which alone has no mark and goes by its name).

    Args:
        name: the file as messages show it.
        file_name: its last part.
        start: its first bytes.

    Raises:
        FileError: the bytes belong to none of them.
    """
    if start[:4] in TIFF_STARTS:
        return "GTiff"
    if start[:4] == b"PK\3\4":
        return "npz"
    if start[:3] in (b"UHL", b"VOL", b"HDR"):
        return "DTED"
    if file_name.lower().endswith(".hgt"):
        return "HGT"
    reject(name, "a DTED, GeoTIFF, HGT or npz raster by its first bytes", f"a file that starts with {start[:8]!r}",
           "Unpack it first." if start[:2] == b"\x1f\x8b" else "")  # fmt: skip


def check_size(name: str, rows: int, columns: int, largest: int) -> None:
    """Refuse a raster with fewer than two rows or columns, or with more posts than allowed.

    Raises:
        FileError: the numbers are out of range.
    """
    if rows < 2 or columns < 2:
        reject(name, "at least 2 rows and 2 columns", f"{rows} rows and {columns} columns")
    if rows * columns > largest:
        hint = "Cut the map, or pass a larger largest=."
        reject(name, f"at most {largest} heights", f"{rows} rows times {columns} columns", hint)


def check_dted(name: str, start: bytes, size: int, largest: int) -> None:
    """Refuse a DTED file whose two headers contradict each other, the size of the file or the globe.

    Args:
        name: the file as messages show it.
        start: its first `HEADER_BYTES` bytes.
        size: its size in bytes.
        largest: number of heights allowed.

    Raises:
        FileError: naming the field.
    """
    first = _before(start)
    uhl, dsi = start[first : first + UHL], start[first + UHL : first + UHL + DSI]
    if uhl[:3] != b"UHL" or dsi[:3] != b"DSI" or len(dsi) < DSI:
        reject(name, "a UHL and a DSI record", "a file without them")
    columns, rows = _whole_number(name, "UHL columns", uhl[47:51]), _whole_number(name, "UHL rows", uhl[51:55])
    check_size(name, rows, columns, largest)
    wanted = first + UHL + DSI + ACC + columns * (12 + 2 * rows)
    if size != wanted:
        reject(name, f"{wanted} bytes for {columns} columns of {rows} posts", f"{size} bytes", "The file is damaged.")
    longitude = _angle(name, "UHL longitude", uhl[4:12], 180.0)
    latitude = _angle(name, "UHL latitude", uhl[12:20], 90.0)
    pairs = (
        ("columns", columns, dsi[285:289]),
        ("rows", rows, dsi[281:285]),
        ("longitude interval", _whole_number(name, "UHL longitude interval", uhl[20:24]), dsi[277:281]),
        ("latitude interval", _whole_number(name, "UHL latitude interval", uhl[24:28]), dsi[273:277]),
    )
    for field, value, other in pairs:
        # some producers leave the second header blank; only a contradiction is an error
        if other.strip() and _whole_number(name, f"DSI {field}", other) != value:
            reject(name, f"DSI {field} {value} as in the UHL record", other.decode(), "The file is damaged.")
    # GDAL takes any other datum as WGS 84, which may be hundreds of meters off
    datum = dsi[144:149].strip(b" \0")
    if datum not in (b"WGS84", b"WGS72", b""):
        reject(name, "WGS84 as DSI horizontal datum", repr(datum), "Convert the file to WGS 84.")
    angles = (("latitude", latitude, dsi[185:194], 90.0), ("longitude", longitude, dsi[194:204], 180.0))
    for field, value, other, limit in angles:
        if other.strip() and abs(_angle(name, f"DSI {field}", other, limit) - value) > 1e-4:
            reject(name, f"DSI {field} {value} as in the UHL record", repr(other), "The file is damaged.")


def check_dted_records(name: str, data: bytes, largest: int) -> np.ndarray:
    """Refuse a DTED file whose columns are not those they say they are, or whose heights are not in sign and magnitude.

    What the headers say must have been checked before. The checksums of the columns are GDAL's to verify.

    Args:
        name: the file as messages show it.
        data: the whole of it.
        largest: number of heights allowed.

    Returns:
        Where a height is "minus zero", `(rows, columns)` with row 0 in the north: the mark of a void in two's complement, no height.

    Raises:
        FileError: naming the column.
    """
    first = _before(data)
    columns, rows = int(data[first + 47 : first + 51]), int(data[first + 51 : first + 55])
    check_size(name, rows, columns, largest)
    records = np.frombuffer(data, np.uint8, offset=first + UHL + DSI + ACC).reshape(columns, 12 + 2 * rows)
    bad = records[:, 0] != SENTINEL
    if bad.any():
        column = int(np.argmax(bad))
        reject(name, f"column {column + 1} to begin with byte {SENTINEL:#x}", f"{records[column, 0]:#x}", "The file is damaged.")
    counts = records[:, 4:6].copy().view(">u2")[:, 0]
    bad = counts != np.arange(columns)
    if bad.any():
        column = int(np.argmax(bad))
        reject(name, f"column {column + 1} of the file to be the meridian {column}", f"{counts[column]}",
               "Columns are missing, doubled or swapped.")  # fmt: skip
    words = records[:, 8:-4].copy().view(">u2")
    strange = (words > 0x8000 + LOWEST_MAGNITUDE) & (words != 0xFFFF)
    if strange.any():
        column, row = np.argwhere(strange)[0]
        reject(name, "heights as sign and magnitude", f"{words[column, row]:#06x} in column {column + 1}, row {row + 1} from the south",
               "These look like two's complement: write the file anew, as DTED asks for.")  # fmt: skip
    return (words == 0x8000).T[::-1]


def _before(data: bytes) -> int:
    """Return how many bytes of tape labels come before the first header."""
    first = 0
    while data[first : first + 3] in (b"VOL", b"HDR"):
        first += UHL
    return first


def _whole_number(name: str, field: str, text: bytes) -> int:
    if not re.fullmatch(rb" *\d+ *", text):
        reject(name, f"a whole number as {field}", repr(text), "The file is damaged.")
    return int(text)


def _angle(name: str, field: str, text: bytes, limit: float) -> float:
    parts = re.fullmatch(rb"(\d{2,3})(\d\d)(\d\d(?:\.\d)?)([NSEW])", text)
    degrees = int(parts[1]) + int(parts[2]) / 60 + float(parts[3]) / 3600 if parts else limit + 1
    if not parts or (parts[4] in b"NS") != (limit == 90.0) or degrees > limit:
        reject(name, f"an angle of at most {limit:.0f} degrees as {field}", repr(text), "The file is damaged.")
    return -degrees if parts[4] in b"SW" else degrees
