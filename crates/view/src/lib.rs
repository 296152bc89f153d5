//! A page to look at logs, captures and a running node: served to a browser on this machine, or written as one file.
//!
//! | module | what it is |
//! |---|---|
//! | [`View`] | what is looked at, and every answer that the page asks for |
//! | `logs` | logs, read once and binned again for each stretch that is looked at |
//! | `links` | the links of captures, evaluated in the background |
//! | `link` | one link: curves, path, phases |
//! | `node` | the states of a running node, from its status socket |
//! | `page` | the page's files, and all of it as one |
//! | [`Server`] | HTTP on one address; `guard` says who is let in |
//!
//! Nothing is computed here that the library and `csi5300_lab` do not compute: the answers are their JSON, binned
//! (docs/reference/formats.md, docs/guides/view.md).
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used))]

mod csi;
mod error;
mod events;
mod guard;
mod link;
mod links;
mod logs;
mod node;
mod page;
mod server;
mod view;

pub use error::Error;
pub use links::Reading;
pub use server::{Ends, Server};
pub use view::{Answer, View};
