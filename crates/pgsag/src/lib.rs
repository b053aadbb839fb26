//! The product: what was typed -> what it means -> which jobs -> a run folder with the result.
//!
//! `pipeline` is the table of stages; `stages` read typed artifacts, call a library function and write; `run` executes
//! any such table and knows no stage by name; `engine` is the only place that chooses a device.

pub mod cli;
pub mod commands;
pub mod config;
pub mod engine;
pub mod error;
pub mod lengths;
pub mod networks;
pub mod photographs;
pub mod pipeline;
pub mod report;
pub mod run;
pub mod stages;
pub mod town_folder;
