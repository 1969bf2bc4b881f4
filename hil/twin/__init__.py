"""How far the emulated robot is from a recorded one: the same commands, and what each measures of them."""
