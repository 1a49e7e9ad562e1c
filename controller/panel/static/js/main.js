// The first module: logs in, then shows one arm or the list of all.

import { showArm } from "./arm.js";
import { showList } from "./list.js";
import { enterByAddress, showLogin } from "./login.js";

await enterByAddress().catch(() => undefined);
const arm = location.pathname.match(/^\/arms\/([A-Za-z0-9_-]+)$/)?.[1];
if (arm) showArm(arm, showLogin);
else showList(showLogin);
