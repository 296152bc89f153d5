//! What viewers are shown of a running robot (feature `foxglove`): the channels of a recording, over a websocket.

#[cfg(not(feature = "foxglove"))]
#[path = "viewers/absent.rs"]
mod shown;
#[cfg(feature = "foxglove")]
mod shown;

pub(super) use shown::Viewers;
