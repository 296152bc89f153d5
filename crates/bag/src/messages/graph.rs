//! The nodes of a participant, for `ros2 node list`: one message for each size of endpoint identifiers (24 bytes in Humble, 16
//! from Iron on).

use super::{Described, messages};
use crate::cdr::{Cdr, CdrError, CdrReader, CdrWriter};

/// A name of at most 256 bytes, as the definition has it.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Name(pub String);

impl Cdr for Name {
    fn write(&self, to: &mut CdrWriter) {
        self.0.write(to);
    }

    fn read(from: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        Cdr::read(from).map(Self)
    }
}

impl Described for Name {
    fn name() -> String {
        "string<=256".into()
    }
}

messages! {
    /// An endpoint's identifier, from Iron on.
    "rmw_dds_common/msg/Gid" Gid { data: [u8; 16] }
    /// A node and its endpoints.
    "rmw_dds_common/msg/NodeEntitiesInfo" NodeEntitiesInfo {
        node_namespace: Name, node_name: Name, reader_gid_seq: Vec<Gid>, writer_gid_seq: Vec<Gid>,
    }
    /// A participant and its nodes.
    "rmw_dds_common/msg/ParticipantEntitiesInfo" ParticipantEntitiesInfo {
        gid: Gid, node_entities_info_seq: Vec<NodeEntitiesInfo>,
    }
}

pub mod humble {
    //! The same in Humble.

    use crate::messages::messages;

    messages! {
        /// An endpoint's identifier.
        "rmw_dds_common/msg/Gid" Gid { data: [u8; 24] }
        /// A node and its endpoints.
        "rmw_dds_common/msg/NodeEntitiesInfo" NodeEntitiesInfo {
            node_namespace: String, node_name: String, reader_gid_seq: Vec<Gid>, writer_gid_seq: Vec<Gid>,
        }
        /// A participant and its nodes.
        "rmw_dds_common/msg/ParticipantEntitiesInfo" ParticipantEntitiesInfo {
            gid: Gid, node_entities_info_seq: Vec<NodeEntitiesInfo>,
        }
    }
}
