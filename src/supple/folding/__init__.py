"""How strong a stroke may be before the map folds, and the smaller strokes that a stronger one becomes."""
