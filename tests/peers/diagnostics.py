"""What a node says about itself on /diagnostics."""

import time
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus

from ros import Ros, nanoseconds

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Diagnostics:
    """The statuses of one node, by default of the stage."""

    def __init__(self, ros: Ros, name: str = "/stage: stage") -> None:
        self.ros, self.name = ros, name
        self.arrays = ros.collect("/diagnostics")

    def until(
        self, condition: Callable[[DiagnosticStatus], bool], what: str, timeout: float = 30.0
    ) -> DiagnosticStatus:
        """Waits for a status that was told after this call and meets the condition."""
        now = time.time_ns()
        del self.arrays[:]

        def told() -> list[DiagnosticStatus]:
            # One that was on its way is of before.
            return [
                status
                for array in self.arrays
                if nanoseconds(array.header.stamp) >= now
                for status in array.status
                if status.name == self.name
            ]

        try:
            return self.ros.until(
                lambda: next((s for s in told() if condition(s)), None), what, timeout
            )
        except AssertionError as failure:
            raise AssertionError(f"{failure}; {self.name} says {told()[-1:]}") from None

    def newest(self) -> DiagnosticStatus:
        return self.until(lambda _: True, f"a status of {self.name}")

    def refusal(self, counter: str, count: int, *words: str) -> DiagnosticStatus:
        """Waits until the counter of refusals stands at `count`; the reason must have the words in
        it."""
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
