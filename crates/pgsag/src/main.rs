//! Parse, plan, execute.

use std::process::ExitCode;

use clap::Parser as _;
use pgsag::cli::Cli;

fn main() -> ExitCode {
    match pgsag::commands::dispatch(Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {}", pgsag::error::one_line(&error));
            ExitCode::from(pgsag::error::exit_code(&error))
        }
    }
}
