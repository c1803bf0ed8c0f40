"""The figures as data, one module a question: a frame in, a description out, its message computed from the frame."""
