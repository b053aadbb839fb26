//! A small town with exact truth, photographed by a ray caster.
