"""Tables, and what else all parts need."""

from bisect import bisect_right


def clip(x, lowest, highest):
    # Half the time of min and max; the twins call it some millions of times.
    x = lowest if x < lowest else x
    return highest if x > highest else x


def ratio(x, y):
    """Return x / y, and 0 where y is 0."""
    return x / y if y != 0 else 0.0


class Look:
    """A piecewise linear table, clipped or extended outside as the table says, with factors on its values and its axes."""

    def __init__(self, table, value=1.0, *axes):
        self.points = [(p * scale).tolist() for p, scale in zip(table.points, axes or (1.0,) * len(table.points), strict=True)]
        self.values, self.clip = (value * table.values).tolist(), table.clip

    def __call__(self, *x):
        return self.between(self.values, 0, x)

    def between(self, values, axis, x):
        points, at, following = self.points[axis], x[axis], axis + 1
        if len(points) == 1:
            return values[0] if following == len(x) else self.between(values[0], following, x)
        if self.clip:
            at = clip(at, points[0], points[-1])
        # The pieces at the ends go on beyond their points.
        above = bisect_right(points, at, 1, len(points) - 1)
        left, low, high = points[above - 1], values[above - 1], values[above]
        if following < len(x):
            low, high = self.between(low, following, x), self.between(high, following, x)
        return low + (at - left) / (points[above] - left) * (high - low)
