"""Where a cable might be: the thinned surface, planes, cylinders through pairs of points, and their tracks."""
