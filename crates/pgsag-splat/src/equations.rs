//! One equation, its gradient, its proof; generic over the number.
