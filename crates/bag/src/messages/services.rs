//! Services: starting and stopping the recording, reading parameters, and the self-test.

use super::messages;
use super::shown::{Byte, DiagnosticStatus};

messages! {
    /// The request; ROS gives an empty message this field.
    "std_srvs/srv/Trigger_Request" TriggerRequest { structure_needs_at_least_one_member: u8 }
    /// Success, and a text.
    "std_srvs/srv/Trigger_Response" TriggerResponse { success: bool, message: String }
    /// The request; ROS gives an empty message this field.
    "diagnostic_msgs/srv/SelfTest_Request" SelfTestRequest { structure_needs_at_least_one_member: u8 }
    /// What was tested, whether all tests passed (1) or not (0), and each test.
    "diagnostic_msgs/srv/SelfTest_Response" SelfTestResponse { id: String, passed: Byte, status: Vec<DiagnosticStatus> }
    /// A parameter's value: the one of the type that `type` names (1 bool, 2 integer, 3 double, 4 string).
    "rcl_interfaces/msg/ParameterValue" ParameterValue {
        r#type: u8, bool_value: bool, integer_value: i64, double_value: f64, string_value: String,
        byte_array_value: Vec<Byte>, bool_array_value: Vec<bool>, integer_array_value: Vec<i64>,
        double_array_value: Vec<f64>, string_array_value: Vec<String>,
    }
    /// Which parameters.
    "rcl_interfaces/srv/GetParameters_Request" GetParametersRequest { names: Vec<String> }
    /// Their values.
    "rcl_interfaces/srv/GetParameters_Response" GetParametersResponse { values: Vec<ParameterValue> }
    /// Parameters with these prefixes, to this depth.
    "rcl_interfaces/srv/ListParameters_Request" ListParametersRequest { prefixes: Vec<String>, depth: u64 }
    /// Their names.
    "rcl_interfaces/msg/ListParametersResult" ListParametersResult { names: Vec<String>, prefixes: Vec<String> }
    /// The answer.
    "rcl_interfaces/srv/ListParameters_Response" ListParametersResponse { result: ListParametersResult }
}
