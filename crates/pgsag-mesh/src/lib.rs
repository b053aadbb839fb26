//! Depth maps to surface to score: the paper's sections 4.4 and 5.
