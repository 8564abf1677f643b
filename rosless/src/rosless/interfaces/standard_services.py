"""Service definitions of standard packages; rosbags' typestore holds messages only."""

_SET_PARAMETERS = "Parameter[] parameters\n---\nSetParametersResult[] results"

# package -> service -> text of its .srv file
TEXTS: dict[str, dict[str, str]] = {
    "rcl_interfaces": {
        "DescribeParameters": "string[] names\n---\nParameterDescriptor[] descriptors",
        "GetParameters": "string[] names\n---\nParameterValue[] values",
        "GetParameterTypes": "string[] names\n---\nuint8[] types",
        "ListParameters": (
            "uint64 DEPTH_RECURSIVE = 0\nstring[] prefixes\nuint64 depth\n---\nListParametersResult result"
        ),
        "SetParameters": _SET_PARAMETERS,
        "SetParametersAtomically": "Parameter[] parameters\n---\nSetParametersResult result",
    },
    "std_srvs": {
        "Empty": "---",
        "SetBool": "bool data\n---\nbool success\nstring message",
        "Trigger": "---\nbool success\nstring message",
    },
}
