"""SDO server: expedited and segmented transfers in both directions (CiA 301)."""

from collections.abc import Callable
from dataclasses import dataclass, field

from friction_hil_drivers.canopen.sdo import dialogue as sdo
from friction_hil_drivers.cia402.access import Abort, AbortError
from friction_hil_drivers.cia402.simulated.dictionary import Dictionary, Entry

_LARGEST = 4096  # bytes of one object: a faulty client must not fill the memory


@dataclass(slots=True)
class _Transfer:
    """A segmented transfer under way."""

    entry: Entry
    is_upload: bool
    data: bytearray = field(default_factory=bytearray)
    size: int | None = None  # announced by the client of a download
    toggle: int = 0


class SdoServer:
    """Serves one client; ``send`` is called with the eight bytes of each response."""

    def __init__(self, dictionary: Dictionary, send: Callable[[bytes], None]) -> None:
        self._dictionary = dictionary
        self._send = send
        self._transfer: _Transfer | None = None
        self._services = {
            sdo.DOWNLOAD_SEGMENT: self._download_segment,
            sdo.DOWNLOAD: self._download,
            sdo.UPLOAD: self._upload,
            sdo.UPLOAD_SEGMENT: self._upload_segment,
        }

    def reset(self) -> None:
        """Forget a transfer under way."""
        self._transfer = None

    def request(self, data: bytes) -> None:
        """Answer a request; one that has not eight bytes is not an SDO request and gets no answer."""
        if len(data) != sdo.FRAME_BYTES:
            return
        command, index, subindex = sdo.HEAD.unpack_from(data)
        specifier = command & sdo.SPECIFIER
        if specifier == sdo.ABORT:
            self._transfer = None
            return
        if specifier in (sdo.DOWNLOAD_SEGMENT, sdo.UPLOAD_SEGMENT):
            transfer = self._transfer
            index, subindex = (transfer.entry.index, transfer.entry.subindex) if transfer else (0, 0)
        else:
            self._transfer = None
        try:
            if specifier not in self._services:  # block transfer is optional
                raise AbortError(Abort.COMMAND)
            self._services[specifier](data)
        except AbortError as error:
            self._transfer = None
            self._send(sdo.abort((index, subindex), error.code))

    def _upload(self, data: bytes) -> None:
        _, index, subindex = sdo.HEAD.unpack_from(data)
        entry = self._dictionary.find(index, subindex)
        value = entry.upload()
        if len(value) <= 4:
            command = sdo.ANSWERS[sdo.UPLOAD] | (4 - len(value)) << 2 | sdo.EXPEDITED | sdo.SIZE_INDICATED
            self._send(sdo.HEAD.pack(command, index, subindex) + value.ljust(4, b"\0"))
        else:
            self._transfer = _Transfer(entry, is_upload=True, data=bytearray(value))
            head = sdo.HEAD.pack(sdo.ANSWERS[sdo.UPLOAD] | sdo.SIZE_INDICATED, index, subindex)
            self._send(head + sdo.LAST_FOUR.pack(len(value)))

    def _upload_segment(self, data: bytes) -> None:
        transfer = self._expected(data[0], is_upload=True)
        segment = bytes(transfer.data[:7])
        del transfer.data[:7]
        command = transfer.toggle | (7 - len(segment)) << 1 | (0 if transfer.data else sdo.LAST)
        transfer.toggle ^= sdo.TOGGLE
        if not transfer.data:
            self._transfer = None
        self._send(bytes([command]) + segment.ljust(7, b"\0"))

    def _download(self, data: bytes) -> None:
        command, index, subindex = sdo.HEAD.unpack_from(data)
        entry = self._dictionary.find(index, subindex)
        if not entry.is_writable:
            raise AbortError(Abort.READ_ONLY)
        if command & sdo.EXPEDITED:
            size = entry.type.bits // 8 or 4
            if command & sdo.SIZE_INDICATED:
                size = 4 - (command >> 2 & 3)
            entry.download(data[4 : 4 + size])
        else:
            announced = sdo.LAST_FOUR.unpack_from(data, 4)[0] if command & sdo.SIZE_INDICATED else None
            if announced is not None and entry.type.bits and announced * 8 != entry.type.bits:
                raise AbortError(Abort.LENGTH)
            self._transfer = _Transfer(entry, is_upload=False, size=announced)
        self._send(sdo.HEAD.pack(sdo.ANSWERS[sdo.DOWNLOAD], index, subindex) + bytes(4))

    def _download_segment(self, data: bytes) -> None:
        command = data[0]
        transfer = self._expected(command, is_upload=False)
        transfer.data += data[1 : 8 - (command >> 1 & 7)]
        if len(transfer.data) > _LARGEST:
            raise AbortError(Abort.OUT_OF_MEMORY)
        if command & sdo.LAST:
            if transfer.size not in (None, len(transfer.data)):
                raise AbortError(Abort.LENGTH)
            transfer.entry.download(bytes(transfer.data))
            self._transfer = None
        self._send(bytes([sdo.ANSWERS[sdo.DOWNLOAD_SEGMENT] | transfer.toggle]) + bytes(7))
        transfer.toggle ^= sdo.TOGGLE

    def _expected(self, command: int, *, is_upload: bool) -> _Transfer:
        """Return the transfer that a segment belongs to; abort where it belongs to none."""
        transfer = self._transfer
        if transfer is None or transfer.is_upload is not is_upload:
            raise AbortError(Abort.COMMAND)
        if command & sdo.TOGGLE != transfer.toggle:
            raise AbortError(Abort.TOGGLE)
        return transfer
