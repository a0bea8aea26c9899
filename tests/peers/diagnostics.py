"""What a node says about itself on /diagnostics."""

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus

from ros import Ros

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Diagnostics:
    """The statuses of one node, by default of the stage."""

    def __init__(self, ros: Ros, name: str = "/stage: stage") -> None:
        self.ros, self.name = ros, name
        self.arrays = ros.collect("/diagnostics")

    def all(self) -> list[DiagnosticStatus]:
        return [status for array in self.arrays for status in array.status if status.name == self.name]

    def until(self, condition: Callable[[DiagnosticStatus], bool], what: str, timeout: float = 30.0) -> DiagnosticStatus:
        """Waits for a status that came after this call and meets the condition."""
        # One that is on its way may be of before.
        del self.arrays[:]
        try:
            return self.ros.until(lambda: next((s for s in self.all() if condition(s)), None), what, timeout)
        except AssertionError as failure:
            newest = self.all()[-1:]
            raise AssertionError(f"{failure}; {self.name} says {newest}") from None

    def newest(self) -> DiagnosticStatus:
        return self.until(lambda _: True, f"a status of {self.name}")

    def refusal(self, counter: str, count: int, *words: str) -> DiagnosticStatus:
        """Waits until the counter of refusals stands at `count`; the reason must have the words in it."""
        status = self.until(lambda status: number(status, counter) >= count, f"{counter} = {count}")
        assert number(status, counter) == count, status
        assert status.level in (WARN, ERROR)
        for word in words:
            assert word in status.message, f"{word!r} is not in {status.message!r}"
        return status


def value(status: DiagnosticStatus, key: str) -> str:
    """The value behind a key, as text."""
    (found,) = [pair.value for pair in status.values if pair.key == key]
    return found


def number(status: DiagnosticStatus, key: str) -> int:
    return int(value(status, key))
