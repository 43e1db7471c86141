//! The OPC UA collector against servers that were not written here, with real faults: asyncua and node-opcua.

#[cfg(test)]
mod commissioning;
#[cfg(test)]
mod hostile;
#[cfg(test)]
mod names;
#[cfg(test)]
mod node_opcua;
#[cfg(test)]
mod past;
#[cfg(test)]
#[path = "../peers/piped.rs"]
mod piped;
#[cfg(test)]
mod reading;
#[cfg(test)]
mod restart;
#[cfg(test)]
mod rig;
#[cfg(test)]
mod security;
