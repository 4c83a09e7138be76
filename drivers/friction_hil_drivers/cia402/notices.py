"""What a node says beside its feedback, in words: emergencies, bits of the statusword, PDOs of a wrong length."""

from friction_hil_drivers.cia402 import profile

_MOST = 100  # different notices of one axis; a node that babbles must not fill the memory
_WATCHED = profile.WARNING | profile.REMOTE | profile.INTERNAL_LIMIT | profile.FOLLOWS_COMMAND
_BIT_TEXTS = (  # (bit, value that is told, text)
    (profile.WARNING, True, "the drive has a warning (6041h bit 7)"),
    (profile.REMOTE, False, "the drive is not in remote control any more (6041h bit 9)"),
    (profile.INTERNAL_LIMIT, True, "an internal limit of the drive is active (6041h bit 11)"),
    (profile.FOLLOWS_COMMAND, False, "the drive does not follow the command any more (6041h bit 12)"),
)


class Notices:
    """Notices of one axis, each kept once, but emergencies each time."""

    __slots__ = ("_bits", "_known", "waiting")

    def __init__(self) -> None:
        self.waiting: list[str] = []  # not handed over yet
        self._known: set[str] = set()
        self._bits: int | None = None  # of the statusword in Operation enabled

    def add(self, text: str) -> None:
        """Keep a notice, unless it is known."""
        if text not in self._known and len(self._known) < _MOST:
            self._known.add(text)
            self.waiting.append(text)

    def tell(self, text: str) -> None:
        """Keep a notice of an event: the same one again has happened again."""
        if len(self.waiting) < _MOST:
            self.waiting.append(text)

    def take_statusword(self, statusword: int, *, is_enabled: bool) -> None:
        """Keep changes of bits that matter while the drive is enabled."""
        if not is_enabled:
            self._bits = None
            return
        bits = statusword & _WATCHED
        if bits == self._bits:
            return
        before, self._bits = self._bits, bits
        for bit, value, text in _BIT_TEXTS:
            # at first only what is set is told: a drive may never set the bits whose loss is watched
            was_so = bool(before & bit) is value if before is not None else not value
            if bool(bits & bit) is value and not was_so:
                self.add(text)
