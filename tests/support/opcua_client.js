// A foreign client (node-opcua): one question a run, the answer as one line of JSON.
// node opcua_client.js URL '{"keys": [...], "seconds": S, "history": KEY, "user": ..., "password": ..., "secure": true}'
const opcua = require("node-opcua-client");
const [url, text] = process.argv.slice(2);
const asked = JSON.parse(text);
const node = (key) => `ns=2;s=${key}`;

function der(path) {
  const lines = require("fs").readFileSync(path, "ascii").split("\n");
  return Buffer.from(lines.filter((line) => !line.startsWith("-")).join(""), "base64");
}

function shown(data) {
  const value = data.value ? data.value.value : null;
  return {
    value: value && value.text !== undefined ? value.text : value,
    status: data.statusCode.name,
    source: data.sourceTimestamp && data.sourceTimestamp.toISOString(),
    server: data.serverTimestamp && data.serverTimestamp.toISOString(),
  };
}

async function main() {
  const { MessageSecurityMode, SecurityPolicy } = opcua;
  const client = opcua.OPCUAClient.create({
    endpointMustExist: false,
    connectionStrategy: { maxRetry: 0 },
    securityMode: asked.secure ? MessageSecurityMode.SignAndEncrypt : MessageSecurityMode.None,
    securityPolicy: asked.secure ? SecurityPolicy.Basic256Sha256 : SecurityPolicy.None,
    ...(asked.server_certificate && { serverCertificate: der(asked.server_certificate) }),
    ...(asked.certificate && { certificateFile: asked.certificate, privateKeyFile: asked.key }),
    transportTimeout: 30000,
  });
  await client.connect(url);
  const user = asked.user && { type: opcua.UserTokenType.UserName, userName: asked.user, password: asked.password };
  const session = await client.createSession(user);
  const answer = { namespaces: await session.readNamespaceArray() };
  const value = { attributeId: opcua.AttributeIds.Value };
  const found = await session.read(asked.keys.map((key) => ({ nodeId: node(key), ...value })));
  answer.read = Object.fromEntries(found.map((data, i) => [asked.keys[i], shown(data)]));
  if (asked.seconds) {
    const wanted = { requestedPublishingInterval: 50, requestedLifetimeCount: 1000, requestedMaxKeepAliveCount: 10,
      maxNotificationsPerPublish: 0, publishingEnabled: true, priority: 0 };
    const subscription = await session.createSubscription2(wanted);
    answer.changes = [];
    for (const key of asked.keys) {
      const item = await subscription.monitor({ nodeId: node(key), ...value },
        { samplingInterval: 50, queueSize: 10, discardOldest: true }, opcua.TimestampsToReturn.Both);
      item.on("changed", (data) => answer.changes.push([key, shown(data)]));
    }
    process.stderr.write("subscribed\n");
    await new Promise((resolve) => setTimeout(resolve, 1000 * asked.seconds));
    await subscription.terminate();
  }
  if (asked.history) {
    const span = [new Date(asked.from), new Date(asked.to)];
    answer.history = [];
    let continuation;
    do {
      const request = new opcua.HistoryReadRequest({
        historyReadDetails: new opcua.ReadRawModifiedDetails({ isReadModified: false, startTime: span[0],
          endTime: span[1], numValuesPerNode: 0, returnBounds: false }),
        nodesToRead: [{ nodeId: node(asked.history), continuationPoint: continuation }],
        timestampsToReturn: opcua.TimestampsToReturn.Both,
      });
      const [result] = (await session.performMessageTransaction(request)).results;
      answer.history_status = result.statusCode.name;
      answer.history.push(...((result.historyData && result.historyData.dataValues) || []).map(shown));
      continuation = result.continuationPoint;
    } while (continuation && continuation.length);
  }
  if (asked.call) {
    const [result] = [await session.call({ objectId: node("unit"), methodId: node(asked.call), inputArguments: [] })];
    answer.call = result.statusCode.name;
  }
  await session.close();
  await client.disconnect();
  return answer;
}

const print = (answer) => process.stdout.write(JSON.stringify(answer) + "\n", () => process.exit(0));
main().then(print, (error) => print({ error: error.message }));
