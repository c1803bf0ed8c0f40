"""What a scene or a step computes, recorded: an intermediate form, its derivative, and its back ends."""
