"""A term of the compensation is switched while the loop runs, as `ros2 param set` does it."""

from pathlib import Path

from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

MODEL = Path(__file__).parents[2] / "examples" / "compensate" / "cogging.yaml"


def test_a_term_is_switched_while_the_loop_runs(ros, stage, controller):
    # No faster than Python reads.
    stage(
        mode="lockstep", control_rate=1000.0, wait_for_command=True, clock_pause=0.002, model=MODEL
    )
    controller(rate=1000.0, bandwidth=30.0, compensation=MODEL)
    states = ros.collect("/controller/state", depth=10)

    def force() -> float:
        return states[-1].forces_feedforward

    def switch(on: bool) -> None:
        wanted = Parameter("compensation_terms.forces", value=on).to_parameter_msg()
        answer = ros.call(SetParameters, "/controller/set_parameters", parameters=[wanted])
        assert [result.successful for result in answer.results] == [True]

    # The cogging at the place where the stage is held.
    held = ros.until(lambda: states and force(), "a force against the cogging")
    switch(False)
    ros.until(lambda: force() == 0.0, "no such force")
    assert states[-1].output != 0.0
    switch(True)
    ros.until(lambda: force() == held, "the force from before")
