//! The product: what was typed -> what it means -> which jobs -> a run folder with the result.
//!
//! `pipeline` is the table of stages; `stages` read typed artifacts, call a library function and write; `run` executes
//! any such table and knows no stage by name; `engine` is the only place that chooses a device.

pub mod config;
pub mod error;
pub mod run;
pub mod town_folder;
