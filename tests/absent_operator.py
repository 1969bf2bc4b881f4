"""An operator for runs that go through without anybody at the terminal."""


class AbsentOperator:
    """Must not be asked."""

    def ask(self, question):
        raise AssertionError(f"asked {question!r}")
