"""`prtcl stress`: stiff and extreme cases on the device against float64, the error that theory allows beside each.

A case is one function that yields trials::

    @case("haar", "Haar transforms of hard patterns")
    def patterns(device: Device, size: Size) -> Iterator[Trial]:
        samples = data.checkerboard(size.levels)
        yield Trial("checkerboard, forward", lambda: haar.forward(device, own).get(), expected, bound, ...)

A trial is run twice, and the two answers must be the same bytes; then it is held against its float64 answer. What is
beyond the bound and not explained, with a figure that it must keep, ends the command with status 1.
"""
