"""Workers for tests of what a run does with them."""


class InTurn:
    """Workers that do one job after the other in this process."""

    def at_once(self, work, jobs):
        return map(work, jobs)
