"""The smooth curve through the samples: B-splines, smoothing, knots, outliers."""
