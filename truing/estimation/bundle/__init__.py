"""Bundle adjustment: rays of images to object points, orientations and cameras, with their whole covariance."""
