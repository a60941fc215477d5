"""File about one robot: its identified models, or its designed filters."""

from abc import abstractmethod
from pathlib import Path
from typing import ClassVar, Self

from drive_profiles.files.safefile import check_writable, write_atomically
from drive_profiles.files.toml import Table, load
from hil.errors import NotPossibleError


class RobotFile(Table):
    """A file about one robot.

    Attributes:
        robot: Name of the bench that it is about.
    """

    kind: ClassVar[str]
    """Name of such a file in messages."""

    robot: str

    @abstractmethod
    def dumps(self) -> str:
        """Return the file as TOML."""

    def save(self, path: Path) -> None:
        """Write the file atomically; replace an existing one.

        Raises:
            FileError: The file cannot be written.
        """
        write_atomically(path, self.dumps().encode(), force=True)

    def check_robot(self, name: str, what: str = "") -> None:
        """Refuse the file of another robot than the bench of this name.

        Raises:
            NotPossibleError: The file belongs to another robot.
        """
        if self.robot != name:
            raise NotPossibleError(f"{what or self.kind} is of robot {self.robot!r}; expected {name!r}; choose another file")

    @classmethod
    def known(cls, path: Path, robot: str) -> Self:
        """Read the file of a robot; without one, return an empty file.

        Raises:
            FileError: The file is not of this kind.
            NotPossibleError: The file belongs to another robot.
        """
        found = load(path, cls) if path.exists() else cls(robot=robot)
        found.check_robot(robot, str(path))
        return found

    @classmethod
    def check_file(cls, path: Path, robot: str) -> None:
        """Check that a file can take a result, before anything is searched or moves for it.

        The file may be missing, its folder may not.

        Raises:
            FileError: The file is not of this kind, or cannot be written.
            NotPossibleError: The file belongs to another robot.
        """
        check_writable(path)
        cls.known(path, robot)
