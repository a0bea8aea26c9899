"""A process under test: its log in a file, and an end that is checked."""

import signal
import subprocess
from pathlib import Path


class Process:
    def __init__(self, command: list[str], log: Path) -> None:
        self.name = Path(command[0]).name
        self.log_path = log
        # Whether its end was wanted and has been checked.
        self.stopped = False
        with log.open("wb") as out:
            out.write((" ".join(command) + "\n").encode())
            out.flush()
            self.popen = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT
            )

    def log(self) -> str:
        """The command line, and what it has written to stdout and stderr so far."""
        return self.log_path.read_text(errors="replace")

    def excerpt(self) -> str:
        """The log for a person: of a long one the beginning and the end."""
        lines = self.log().splitlines()
        if len(lines) > 80:
            lines = [*lines[:20], f"... {len(lines) - 60} lines ...", *lines[-40:]]
        return "\n".join(lines)

    def outcome(self) -> str:
        code = self.popen.poll()
        return "still running" if code is None else f"exit code {code}"

    def wait(self, timeout: float = 15.0) -> int:
        """Its exit code, when it ends by itself within `timeout` seconds."""
        try:
            return self.popen.wait(timeout)
        except subprocess.TimeoutExpired:
            raise AssertionError(
                f"{self.name} did not end within {timeout} s:\n{self.excerpt()}"
            ) from None

    def stop(
        self, how: signal.Signals = signal.SIGTERM, expected: int | tuple[int, ...] = 0
    ) -> None:
        """Ends it with a signal, unless it has ended, and checks its exit code, once."""
        if self.stopped:
            return
        self.stopped = True
        ran = self.popen.poll() is None
        if ran:
            self.popen.send_signal(how)
        try:
            code = self.popen.wait(15.0)
        except subprocess.TimeoutExpired:
            self.popen.kill()
            self.popen.wait()
            raise AssertionError(
                f"{self.name} did not end within 15 s of {how.name}:\n{self.excerpt()}"
            ) from None
        allowed = expected if isinstance(expected, tuple) else (expected,)
        assert code in allowed, (
            f"{self.name} {f'answered {how.name}' if ran else 'ended by itself'} with exit code {code} "
            f"instead of {expected}:\n{self.excerpt()}"
        )

    def ended(self, expected: int) -> None:
        """Marks that it ended as the test wanted, and checks how."""
        code = self.wait()
        self.stopped = True
        assert code == expected, (
            f"{self.name} ended with exit code {code} instead of {expected}:\n{self.excerpt()}"
        )
