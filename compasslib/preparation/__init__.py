"""From decoded exports to pairs of measurements of nearly the same water."""
