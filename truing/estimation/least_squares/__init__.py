"""Non-linear least squares, damped, one problem or many abreast."""
