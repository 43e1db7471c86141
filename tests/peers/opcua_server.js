// An OPC UA server made of node-opcua, for what is to be shown against a second implementation.
//
// Prints "port N" once it listens. Reads commands from stdin, one a line, and answers each with "ok":
//
//   set NODE V     writes a value with the time of now
//
// Arguments: a folder with server.der and server.pem or for others, the port (0: any free one), and for how many seconds before the start there
// is history, as by a historian that went on while no server ran.
//
// Nodes of namespace 1: Steady0..Steady29 hold 0.0..29.0 and have the EURange 0 to 100. Counter, below Plant, has none; it
// changes every 40 ms, its value is the number of 20 ms since the Unix epoch, and its history is kept. No request may
// name more than ten nodes, and one of history not more than one. With security only SignAndEncrypt is offered.
"use strict";

const fs = require("node:fs");
const net = require("node:net");
const path = require("node:path");
const readline = require("node:readline");

const modules = path.join(__dirname, "../../target/peers-node/node_modules");
const load = (name) => require(path.join(modules, name));
const { OPCUAServer, MonitoredItem } = load("node-opcua-server");
const { OPCUACertificateManager } = load("node-opcua-certificate-manager");
const { nodesets } = load("node-opcua-nodesets");
const { DataType, Variant } = load("node-opcua-variant");
const { StatusCodes } = load("node-opcua-status-code");
const { MessageSecurityMode, SecurityPolicy } = load("node-opcua-secure-channel");

const TICK_MS = 20;
const STEP = 2;
const URI = "urn:peer";

const number = (value) => new Variant({ dataType: DataType.Double, value });

function freePort() {
    return new Promise((resolve) => {
        const probe = net.createServer();
        probe.listen(0, "127.0.0.1", () => {
            const { port } = probe.address();
            probe.close(() => resolve(port));
        });
    });
}

// Those in the folder, else of the library's own making.
function certificates(folder) {
    const [certificateFile, privateKeyFile] = ["server.der", "server.pem"].map((name) => path.join(folder, name));
    const rootFolder = path.join(folder, "node");
    const serverCertificateManager = new OPCUACertificateManager({
        rootFolder,
        automaticallyAcceptUnknownCertificate: true,
    });
    const given = fs.existsSync(certificateFile) ? { certificateFile, privateKeyFile } : {};
    return { serverCertificateManager, serverInfo: { applicationUri: URI }, ...given };
}

async function start(folder, port, backlogS) {
    const server = new OPCUAServer({
        ...certificates(folder),
        port,
        resourcePath: "/peer/",
        nodeset_filename: [nodesets.standard],
        securityModes: [MessageSecurityMode.None, MessageSecurityMode.SignAndEncrypt],
        securityPolicies: [SecurityPolicy.None, SecurityPolicy.Basic256Sha256, SecurityPolicy.Aes256_Sha256_RsaPss],
        serverCapabilities: {
            operationLimits: {
                maxNodesPerRead: 10,
                maxMonitoredItemsPerCall: 10,
                maxNodesPerTranslateBrowsePathsToNodeIds: 10,
                maxNodesPerHistoryReadData: 1,
            },
        },
    });
    await server.initialize();
    // Faster than the usual 50 ms, so that every step of the counter is seen.
    MonitoredItem.minimumSamplingInterval = 10;
    const { addressSpace } = server.engine;
    const own = addressSpace.getOwnNamespace();
    const plant = own.addObject({ browseName: "Plant", nodeId: "s=Plant", organizedBy: addressSpace.rootFolder.objects });
    const nodes = new Map();
    for (let k = 0; k < 30; k += 1) {
        const name = `Steady${k}`;
        const node = own.addAnalogDataItem({
            browseName: name,
            nodeId: `s=${name}`,
            componentOf: plant,
            dataType: "Double",
            engineeringUnitsRange: { low: 0, high: 100 },
            minimumSamplingInterval: 10,
            value: number(k),
        });
        nodes.set(name, node);
    }
    const counter = own.addVariable({
        browseName: "Counter",
        nodeId: "s=Counter",
        componentOf: plant,
        dataType: "Double",
        minimumSamplingInterval: 10,
        value: number(0),
    });
    let tick = Math.floor((Date.now() / 1000 - backlogS) * (1000 / TICK_MS / STEP)) * STEP;
    const count = () => {
        for (; tick * TICK_MS <= Date.now(); tick += STEP) {
            counter.setValueFromSource(number(tick), StatusCodes.Good, new Date(tick * TICK_MS));
            // History begins with the value of then, not with the nothing before it.
            if (!counter.varHistorian) addressSpace.installHistoricalDataNode(counter, { maxOnlineValues: 100000 });
        }
    };
    count();
    setInterval(count, TICK_MS / 2);
    await server.start();
    return nodes;
}

async function main() {
    const [folder, asked, backlogS] = process.argv.slice(2);
    const port = Number(asked) || (await freePort());
    const nodes = await start(folder, port, Number(backlogS));
    console.log(`port ${port}`);
    for await (const line of readline.createInterface({ input: process.stdin })) {
        const [command, name, value] = line.split(" ");
        if (command !== "set") throw new Error(`unknown command ${line}`);
        nodes.get(name).setValueFromSource(number(Number(value)), StatusCodes.Good, new Date());
        console.log("ok");
    }
    process.exit(0);
}

main().catch((error) => {
    console.error(error);
    process.exit(1);
});
