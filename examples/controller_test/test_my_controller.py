"""A test of a position controller, on a stage that friction holds:
pytest -p friction_stage_testing"""


class MyController:
    """PID at 1 kHz, 30 Hz on 40 kg."""

    p, i, d = 0.5e6, 2.0e7, 5.0e3

    def __init__(self) -> None:
        self.sum = self.last = 0.0

    def force(self, error: float) -> float:
        self.sum += 1e-3 * error
        rate, self.last = 1e3 * (error - self.last), error
        return self.p * error + self.i * self.sum + self.d * rate


def test_my_controller_steps_by_1_um_and_settles_to_50_nm(friction_stage):
    stage = friction_stage(model="guide_2", control_rate=1000.0)
    controller = MyController()
    for _ in range(2000):
        stage.step(controller.force(1e-6 - stage.sample.position[0]))
    errors = [sample.position[0] - 1e-6 for sample in stage.samples[-100:]]
    assert max(map(abs, errors)) < 50e-9
