"""Encoding of a text file: UTF-8, UTF-16 and Windows' cp1252. Pure."""

from pathlib import Path

from friction_hil.errors import RecordingError

_BOM = b"\xef\xbb\xbf"
_UTF_16 = {b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be"}
_SAMPLE = 400  # bytes that show the zeros of UTF-16 without a mark
_ZEROS = 0.8  # of every second byte
_MOST_SPECIAL = 0.1  # of the bytes of a cp1252 text that are not ASCII; a binary file has more
_CONTROL = bytes(set(range(32)) - set(b"\0\t\n\f\r"))


def as_utf_8(path: Path, data: bytes, problems: list[str]) -> bytes:
    """Return the text as UTF-8 without a mark; say in ``problems`` if that took a guess.

    Raises `RecordingError`: the bytes are no text.
    """
    mark = _UTF_16.get(data[:2])
    encoding = mark or (0 in data[:_SAMPLE] and _utf_16_without_mark(data[:_SAMPLE]))
    if encoding:
        try:
            return data[2 if mark else 0 :].decode(encoding).encode()
        except UnicodeError as error:
            raise RecordingError(f"{path} begins as {encoding.upper()} text, and then is none ({error})") from None
    data = data.removeprefix(_BOM)
    try:
        data.decode()
    except UnicodeDecodeError as error:
        if not _may_be_cp1252(data):
            raise not_text(path, error.start) from None
    else:
        return data
    try:
        text = data.decode("cp1252")
    except UnicodeDecodeError as error:
        raise not_text(path, error.start) from None
    problems.append("the text is not UTF-8 and is read as cp1252 (Windows, Western Europe)")
    return text.encode()


def not_text(path: Path, byte: int) -> RecordingError:
    """Return the error for a file that is no text."""
    return RecordingError(f"{path} is not a UTF-8 text file (byte {byte}), nor UTF-16 or cp1252")


def _utf_16_without_mark(head: bytes) -> str:
    if len(head) < 4:
        return ""
    for encoding, zeros, others in ("utf-16-le", head[1::2], head[::2]), ("utf-16-be", head[::2], head[1::2]):
        if zeros.count(0) >= _ZEROS * len(zeros) and 0 not in others:
            return encoding
    return ""


def _may_be_cp1252(data: bytes) -> bool:
    special = len(data) - len(data.translate(None, bytes(range(128, 256))))
    return special <= _MOST_SPECIAL * len(data) and len(data.translate(None, _CONTROL)) == len(data)
