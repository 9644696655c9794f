//! The gateway, from outside: in one program, for each that links zenoh takes its time.

mod authority;
mod bed;
mod chaos;
mod config;
mod crossing;
mod cuts;
mod ends;
mod hostile;
mod ip;
mod messages;
mod program;
mod redundant;
mod secure;
