"""Tables, and what else all parts need."""

from bisect import bisect_right


def clip(x, lowest, highest):
    return min(max(x, lowest), highest)


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
        points, at, last = self.points[axis], x[axis], axis + 1 == len(x)
        if len(points) == 1:
            return values[0] if last else self.between(values[0], axis + 1, x)
        if self.clip:
            at = clip(at, points[0], points[-1])
        i = clip(bisect_right(points, at) - 1, 0, len(points) - 2)
        share = (at - points[i]) / (points[i + 1] - points[i])
        low, high = (values[i], values[i + 1]) if last else (self.between(values[j], axis + 1, x) for j in (i, i + 1))
        return low + share * (high - low)
