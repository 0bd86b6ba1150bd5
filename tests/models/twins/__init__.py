"""Whole vehicles a second time, by hand: loops and plain numbers, no faces, no links, no expressions.

Written from the paper's equations and the block diagrams of the original, with the departures that the manual's page on the
method lists; not from the component files.  Each part is a small class with floats for its memories: `required` takes what the
wheel's side asks and returns what it asks of the next part, `available` takes what comes and returns what is delivered.  Both
write what they found into `seen`, under the names of the outputs.  `vehicles.py` puts parts together.

A point of a shaft is a triple of torque [N.m], speed [rad/s] and required acceleration [rad/s^2] on the way there, a pair without
the acceleration on the way back.
"""
