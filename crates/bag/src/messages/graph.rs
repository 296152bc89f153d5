//! Which nodes a participant has, as `ros2 node list` wants to know: one message for each size of name (Humble's names of
//! endpoints have 24 bytes, those from Iron on 16).

use super::messages;

messages! {
    /// An endpoint's name, from Iron on.
    "rmw_dds_common/msg/Gid" Gid { data: [u8; 16] }
    /// A node and its endpoints.
    "rmw_dds_common/msg/NodeEntitiesInfo" NodeEntitiesInfo {
        node_namespace: String, node_name: String, reader_gid_seq: Vec<Gid>, writer_gid_seq: Vec<Gid>,
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
        /// An endpoint's name.
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
