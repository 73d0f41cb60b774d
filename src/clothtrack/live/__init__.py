"""Live tracking of the whole cloth: the steps of Algorithm 1 on a growing recording."""
