//! The backend against naive arithmetic.
