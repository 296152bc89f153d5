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
//! The answers are the JSON of the library and of `csi5300_lab` (docs/reference/formats.md), binned. docs/guides/view.md is the guide.
//!
//! # Requests of the page
//!
//! `GET` returns JSON. A page that is one file holds the answers without a query in its element `answers`.
//!
//! * `/data/overview`: `program` (version), `name`, `kind` (`captures`, `logs`, `node`), `logs`, `links` (names), `trajectory`, `has_beside`
//! * `/data/rows?known=N`: links after the first N: as `evaluate --json`, `number`, `set`, `beside` (of `links.csv`); `known`, `of`, `notes`
//! * `/data/sets`: summary of `evaluate --json` by set; `beside`: the other program's
//! * `/data/link/N`: until evaluated: `waiting` (true), `logs`; then `row` (as `evaluate --json`), `receiver` (located), numbers of `logs` (`receiver`, `transmitter`), `drawn`
//! * `/data/log/N`: as `info --json`, `senders` as a list; `span_s`, `subcarriers` (indices), `antennas` (letters), `rssi_in_dbm`
//! * `/data/log/N/levels?from=&to=&columns=&sender=`: from `from_s` to `to_s` in `columns`: `records`, `rate_hz`; `min`, `mean`, `max` of `rssi` and `agc`; (column, count) of `missing`, `damaged`, `skipped`, `repeated`; `gaps_s`, `steps_back`
//! * `/data/log/N/csi?from=&to=&columns=&sender=&antenna=`: column means of every n-th record (`every`); for each `antenna` in `antennas` `amplitude_db`, `phase_rad`; `cells`: bytes in base64, `[row][column]`, 0 `low`, 254 `high`, 255 nothing; `rows` of `subcarriers_a_row` each, with the index of their middle one in `subcarriers`; of other cards kind and width of `frames`, and how many `other_frames` have another one; without `sender=` that of the log's most frequent `sender`
//! * `/data/log/N/levels`, `/data/log/N/csi` of a log replaced, cut or rewritten: status 409; the next `/data/log/N` reads it again. Growth is no change
//! * `/data/states`: last 1,200 states of a node
//! * `/events`: server-sent events: `rows`, `state` (of a node), `silent`
//!
//! `drawn` is null without a bearing; long rows are thinned:
//!
//! * `curves`: profiles, the answer's first: `name`, `azimuths_deg`, `values` relative to their highest
//! * `path_m`, `used_m`, `mean_position_m`: (x, y) of the trajectory, of pairs used, their mean (the origin)
//! * `phases`: at `t_s` of all pairs: `one_way_rad` (forward), `round_trip_rad`, `compensated_rad`; at `left_t_s` (from the first pair used) `left_rad`: residual about its mean
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
