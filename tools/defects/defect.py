"""A defect: a text of a file of altd, and the one that replaces it."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Defect:
    """A defect; ``at`` is the place of ``old`` in the file, None if it occurs there once."""

    what: str
    file: str
    old: str
    new: str
    at: int | None = None

    @property
    def room(self) -> str:
        """Package or module of altd that contains the defect."""
        return room_of(self.file)

    def put_into(self, text: str) -> str:
        """Return the file's text with the defect; raises ValueError where it has no place any more."""
        begin = text.find(self.old) if self.at is None else self.at
        end = begin + len(self.old)
        if begin < 0 or text[begin:end] != self.old or (self.at is None and self.old in text[begin + 1 :]):
            raise ValueError(f"{self.file}: the defect has no place there any more: {self.what}")
        return text[:begin] + self.new + text[end:]


def room_of(file: str) -> str:
    """Return the package or module of altd that a file belongs to."""
    return file.split("/")[1].removesuffix(".py")
