"""`prtcl bench`: every stage's speed against the device's own limits, its answer against float64, and its rivals.

A stage is one function in a module of stages (`transforms`, `light`, `shading`)::

    @stage("sparse_reduction", rows=2)
    def sparse_reduction(device: Device, points: int, levels: int, channels: int) -> Job:
        size = Size(points, levels, channels)
        coefficients = world.light_rows(device, size, transformed=True)
        ...
        return Job(call, bytes_moved, flops, check)

and is then run, checked, tabled, plotted and compared like the others. A rival is one in `rivals_*`.
"""
