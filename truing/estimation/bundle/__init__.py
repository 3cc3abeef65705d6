"""Bundle adjustment: object points, image orientations and cameras from image rays, with their full covariance."""
