// Sums of one Gaussian over pixels; (dx, dy) from its centre, v = alpha * d alpha.
//   0 v, 1 v dx, 2 v dy, 3 v dx^2, 4 v dx dy, 5 v dy^2, 6-8 colour, 9-11 normal, 12 distance,
//   13 and 14 absolute screen gradient (in units of the record), 15 pixels covered, 16 and 17 v dx, v dy without the load.
// `pull` puts the gradients of the parameters in their place: mean 3, log scales 3, quaternion 4, logit, colour 3.

const SUMS: u32 = 18u;
