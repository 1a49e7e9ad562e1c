// The first module: logs in, then shows one arm or the list of all.

import { showArm } from "./arm.js";
import { showList } from "./list.js";
import { enterByAddress, showLogin } from "./login.js";

const refusal = await enterByAddress();
const arm = location.pathname.match(/\/arms\/([A-Za-z0-9_-]+)$/)?.[1];
if (refusal) showLogin(refusal);
else if (arm) showArm(arm, showLogin);
else showList(showLogin);
