//! node-opcua.
